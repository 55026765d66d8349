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
    /// Writes what is at an address into a stream. Throws CaptureFault UNREACHABLE or FILE_MISSING. Called away from the
    /// main thread, several at once.
    /// </summary>
    public delegate Task Fetch(string url, Stream into);

    /// <summary>The usual way to fetch: .NET's own HTTP client, which never touches the engine's main thread.</summary>
    public static class Http
    {
        // A server that sends nothing for so long has gone. The whole of a download may take any time.
        private static readonly TimeSpan Silence = TimeSpan.FromSeconds(15);
        private const int PieceBytes = 1 << 16;

        private static readonly IReadOnlyDictionary<string, string> NoHeaders = new Dictionary<string, string>();

        private static readonly HttpClient Client = new HttpClient { Timeout = Timeout.InfiniteTimeSpan };

        public static Task Fetch(string url, Stream into) => Fetch(url, into, NoHeaders);

        /// <summary>Fetch with these headers. Throws CaptureFault ACCESS_REFUSED, too.</summary>
        public static async Task Fetch(string url, Stream into, IReadOnlyDictionary<string, string> headers)
        {
            using (var patience = new CancellationTokenSource(Silence))
            {
                try
                {
                    await Copy(url, into, headers, patience).ConfigureAwait(false);
                }
                catch (OperationCanceledException fault)
                {
                    throw Unreachable(url, $"it sent nothing for {Silence.TotalSeconds} s", fault);
                }
                catch (HttpRequestException fault)
                {
                    throw Unreachable(url, (fault.InnerException ?? fault).Message, fault);
                }
                catch (WebException fault)
                {
                    throw Unreachable(url, fault.Message, fault);
                }
            }
        }

        private static async Task Copy(string url, Stream into, IReadOnlyDictionary<string, string> headers, CancellationTokenSource patience)
        {
            var request = new HttpRequestMessage(HttpMethod.Get, url);
            foreach (var header in headers) request.Headers.TryAddWithoutValidation(header.Key, header.Value);
            var whole = HttpCompletionOption.ResponseHeadersRead;
            using (request)
            using (var response = await Client.SendAsync(request, whole, patience.Token).ConfigureAwait(false))
            {
                Check(url, response.StatusCode);
                using (var body = await response.Content.ReadAsStreamAsync().ConfigureAwait(false))
                {
                    await Drain(url, body, into, patience).ConfigureAwait(false);
                }
            }
        }

        private static async Task Drain(string url, Stream body, Stream into, CancellationTokenSource patience)
        {
            var piece = new byte[PieceBytes];
            while (true)
            {
                patience.CancelAfter(Silence);
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
                throw Unreachable(url, fault.Message, fault);
            }
        }

        private static void Check(string url, HttpStatusCode status)
        {
            if (status == HttpStatusCode.Unauthorized || status == HttpStatusCode.Forbidden)
            {
                throw new CaptureFault(CaptureFault.AccessRefused, $"{url}: it answers {(int)status}", "It is private: log in");
            }
            if (status == HttpStatusCode.NotFound || status == HttpStatusCode.Gone)
            {
                throw new CaptureFault(CaptureFault.FileMissing, $"{url} is not there", "A newer version may have come");
            }
            if ((int)status < 200 || (int)status > 299) throw Unreachable(url, $"it answers {(int)status}", null);
        }

        private static CaptureFault Unreachable(string url, string reason, Exception cause)
        {
            return new CaptureFault(CaptureFault.Unreachable, $"{url}: {reason}", "Check the connection", cause);
        }
    }
}
