using System;
using System.Collections.Generic;
using System.IO;
using System.Threading.Tasks;

namespace Capture2vr
{
    /// <summary>
    /// HTTP headers that tell a server who asks, for private assets: sent to what is below one address and to nobody else,
    /// and renewed where they are refused. Used by several threads at once.
    /// </summary>
    public sealed class AccessHeaders
    {
        private static readonly IReadOnlyDictionary<string, string> None = new Dictionary<string, string>();

        private readonly object _gate = new object();
        private IReadOnlyDictionary<string, string> _current = None;
        private readonly Transport _transport;
        private Task<bool> _renewing;

        /// <param name="baseUrl">what lies below it gets the headers</param>
        public AccessHeaders(string baseUrl, Transport transport)
        {
            BaseUrl = baseUrl.TrimEnd('/');
            _transport = transport;
        }

        public string BaseUrl { get; }

        /// <summary>The headers, such as Authorization with an access key. Null is none.</summary>
        public IReadOnlyDictionary<string, string> Current
        {
            get
            {
                lock (_gate) return _current;
            }
            set
            {
                lock (_gate) _current = value ?? None;
            }
        }

        /// <summary>
        /// Returns new headers when the server has refused the present ones, so that a key may expire while the app runs. Called
        /// away from the main thread where there are others. Null where there is no way to get any.
        /// </summary>
        public Func<Task<IReadOnlyDictionary<string, string>>> Renewal { get; set; }

        /// <summary>Whether an address lies below this one, with ".." and the like resolved.</summary>
        public bool Covers(string url)
        {
            return Uri.TryCreate(BaseUrl + "/", UriKind.Absolute, out var own) && Uri.TryCreate(url, UriKind.Absolute, out var asked)
                && asked.AbsoluteUri.StartsWith(own.AbsoluteUri, StringComparison.Ordinal);
        }

        /// <summary>The headers of a request: none for what lies elsewhere.</summary>
        public IReadOnlyDictionary<string, string> For(string url) => Covers(url) ? Current : None;

        /// <summary>
        /// Ask for new headers after the server has refused some. Whoever asks while others do gets the same. False where there
        /// are none.
        /// </summary>
        /// <param name="refused">those that were sent: where others are there by now, they count as new</param>
        public Task<bool> RenewAsync(IReadOnlyDictionary<string, string> refused)
        {
            lock (_gate)
            {
                if (!ReferenceEquals(_current, refused)) return Task.FromResult(true);
                if (Renewal == null) return Task.FromResult(false);
                if (_renewing == null || _renewing.IsCompleted) _renewing = Renew();
                return _renewing;
            }
        }

        /// <summary>Fetch with the headers; a second time with new ones where the server refuses them.</summary>
        public async Task Fetch(string url, Stream into)
        {
            var headers = For(url);
            try
            {
                await _transport(url, into, headers).ConfigureAwait(Background.ComesBack);
                return;
            }
            catch (CaptureFault fault) when (fault.Code == CaptureFault.AccessRefused && Covers(url))
            {
                if (!await RenewAsync(headers).ConfigureAwait(Background.ComesBack)) throw;
            }
            await _transport(url, into, For(url)).ConfigureAwait(Background.ComesBack);
        }

        private async Task<bool> Renew()
        {
            await Task.Yield(); // the app's code must not run inside the lock
            Current = await Renewal().ConfigureAwait(Background.ComesBack);
            return true;
        }
    }
}
