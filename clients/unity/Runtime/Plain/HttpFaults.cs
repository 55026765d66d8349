using System;

namespace Capture2vr
{
    /// <summary>What an answer's status and a network's failure mean, whoever speaks HTTP.</summary>
    internal static class HttpFaults
    {
        /// <summary>A server that sends nothing for so long has gone. The whole of a download may take any time.</summary>
        public static TimeSpan Patience = TimeSpan.FromSeconds(15);

        /// <summary>Throws CaptureFault UNREACHABLE for what is no address of a web server.</summary>
        public static void CheckAddress(string url)
        {
            if (Uri.TryCreate(url, UriKind.Absolute, out var address) && address.Host != ""
                && (address.Scheme == Uri.UriSchemeHttp || address.Scheme == Uri.UriSchemeHttps)) return;
            throw new CaptureFault(CaptureFault.Unreachable, $"{url} is no address of a web server", "Begin it with https:// and the host's name");
        }

        /// <summary>Throws CaptureFault ACCESS_REFUSED, FILE_MISSING or UNREACHABLE for a status that is no success.</summary>
        public static void Check(string url, long status)
        {
            if (status == 401 || status == 403)
            {
                throw new CaptureFault(CaptureFault.AccessRefused, $"{url}: it answers {status}", "It is private: log in");
            }
            if (status == 404 || status == 410)
            {
                throw new CaptureFault(CaptureFault.FileMissing, $"{url} is not there", "A newer version may have come");
            }
            if (!IsSuccess(status)) throw Unreachable(url, $"it answers {status}");
        }

        public static bool IsSuccess(long status) => status >= 200 && status <= 299;

        public static CaptureFault Silent(string url, Exception cause = null)
        {
            return Unreachable(url, $"it sent nothing for {Patience.TotalSeconds} s", cause);
        }

        public static CaptureFault Unreachable(string url, string reason, Exception cause = null)
        {
            return new CaptureFault(CaptureFault.Unreachable, $"{url}: {reason}", "Check the connection", cause);
        }
    }
}
