using System;
using System.Collections.Generic;
using System.IO;
using System.Net;
using System.Net.Http;
using System.Threading;
using System.Threading.Tasks;

namespace Capture2vr
{
    /// <summary>
    /// Writes what is at an address into a stream. Throws CaptureFault UNREACHABLE, FILE_MISSING or ACCESS_REFUSED. Called
    /// away from the main thread where there are others, several at once.
    /// </summary>
    public delegate Task Fetch(string url, Stream into);

    /// <summary>A way to fetch that sends these headers: Http.Fetch, UnityHttp.Fetch, or one of the app's own.</summary>
    public delegate Task Transport(string url, Stream into, IReadOnlyDictionary<string, string> headers);

    /// <summary>Fetches by .NET's own HTTP client, which never touches the engine's main thread. Not in a browser.</summary>
    public static class Http
    {
        private const int PieceBytes = 1 << 16;

        private static readonly IReadOnlyDictionary<string, string> NoHeaders = new Dictionary<string, string>();

        private const int MostRedirects = 5;

        // Its own way to follow redirections would show headers to any server.
        private static readonly HttpClient Client = new HttpClient(new HttpClientHandler { AllowAutoRedirect = false }) { Timeout = Timeout.InfiniteTimeSpan };

        public static Task Fetch(string url, Stream into) => Fetch(url, into, NoHeaders);

        /// <summary>Fetch with these headers.</summary>
        public static async Task Fetch(string url, Stream into, IReadOnlyDictionary<string, string> headers)
        {
            HttpFaults.CheckAddress(url);
            using (var patience = new CancellationTokenSource(HttpFaults.Patience))
            {
                try
                {
                    await Copy(url, into, headers, patience).ConfigureAwait(false);
                }
                catch (OperationCanceledException fault)
                {
                    throw HttpFaults.Silent(url, fault);
                }
                catch (HttpRequestException fault)
                {
                    throw HttpFaults.Unreachable(url, (fault.InnerException ?? fault).Message, fault);
                }
                catch (WebException fault)
                {
                    throw HttpFaults.Unreachable(url, fault.Message, fault);
                }
            }
        }

        private static async Task Copy(string url, Stream into, IReadOnlyDictionary<string, string> headers, CancellationTokenSource patience)
        {
            var first = new Uri(url);
            var asked = first;
            for (var redirects = 0; asked != null; redirects++)
            {
                using (var request = Request(asked, IsOfOneServer(asked, first) ? headers : NoHeaders))
                using (var response = await Client.SendAsync(request, HttpCompletionOption.ResponseHeadersRead, patience.Token).ConfigureAwait(false))
                {
                    asked = redirects < MostRedirects ? Target(response, asked) : null;
                    if (asked != null) continue;
                    HttpFaults.Check(url, (long)response.StatusCode);
                    using (var body = await response.Content.ReadAsStreamAsync().ConfigureAwait(false))
                    {
                        await Drain(url, body, into, patience).ConfigureAwait(false);
                    }
                }
            }
        }

        private static HttpRequestMessage Request(Uri address, IReadOnlyDictionary<string, string> headers)
        {
            var request = new HttpRequestMessage(HttpMethod.Get, address);
            foreach (var header in headers) request.Headers.TryAddWithoutValidation(header.Key, header.Value);
            return request;
        }

        private static bool IsOfOneServer(Uri a, Uri b) => a.GetLeftPart(UriPartial.Authority) == b.GetLeftPart(UriPartial.Authority);

        /// <summary>Where a redirection leads to, or null; a secure address leads to no other kind.</summary>
        private static Uri Target(HttpResponseMessage response, Uri asked)
        {
            var status = (int)response.StatusCode;
            var leadsOn = status == 301 || status == 302 || status == 303 || status == 307 || status == 308;
            if (!leadsOn || response.Headers.Location == null) return null;
            var target = new Uri(asked, response.Headers.Location);
            var isWeb = target.Scheme == Uri.UriSchemeHttps || (target.Scheme == Uri.UriSchemeHttp && asked.Scheme == Uri.UriSchemeHttp);
            return isWeb ? target : null;
        }

        private static async Task Drain(string url, Stream body, Stream into, CancellationTokenSource patience)
        {
            var piece = new byte[PieceBytes];
            while (true)
            {
                patience.CancelAfter(HttpFaults.Patience);
                var count = await Read(url, body, piece, patience.Token).ConfigureAwait(false);
                if (count == 0) return;
                into.Write(piece, 0, count);
            }
        }

        /// <summary>Only what the network does wrong becomes UNREACHABLE here; the device's storage is another matter.</summary>
        private static async Task<int> Read(string url, Stream body, byte[] piece, CancellationToken cancel)
        {
            try
            {
                return await body.ReadAsync(piece, 0, piece.Length, cancel).ConfigureAwait(false);
            }
            catch (IOException fault)
            {
                throw HttpFaults.Unreachable(url, fault.Message, fault);
            }
        }
    }
}
