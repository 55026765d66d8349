using System;
using System.IO;
using System.Security.Cryptography;
using System.Text;

namespace Capture2vr
{
    /// <summary>SHA-256 as 64 lower-case hexadecimal digits.</summary>
    public static class Sha256
    {
        public const int Digits = 64;

        public static string Of(byte[] data)
        {
            using (var sha = SHA256.Create()) return Hex(sha.ComputeHash(data));
        }

        /// <summary>Of what is left of a stream, in pieces: a file need not fit into memory.</summary>
        public static string Of(Stream stream)
        {
            using (var sha = SHA256.Create()) return Hex(sha.ComputeHash(stream));
        }

        public static string Hex(byte[] bytes)
        {
            var text = new StringBuilder(2 * bytes.Length);
            foreach (var each in bytes) text.Append(each.ToString("x2"));
            return text.ToString();
        }

        public static bool IsHash(string text)
        {
            return text != null && text.Length == Digits && IsLowerHex(text);
        }

        /// <summary>The hash in a name such as <c>lod0.&lt;sha256&gt;.glb</c>, or null where there is none.</summary>
        public static string InName(string url)
        {
            var path = url.Split('?', '#')[0];
            var parts = path.Substring(path.LastIndexOf('/') + 1).Split('.');
            var candidate = parts.Length < 3 ? null : parts[parts.Length - 2];
            return IsHash(candidate) ? candidate : null;
        }

        private static bool IsLowerHex(string text)
        {
            foreach (var letter in text)
            {
                if (!(letter >= '0' && letter <= '9') && !(letter >= 'a' && letter <= 'f')) return false;
            }
            return true;
        }
    }
}
