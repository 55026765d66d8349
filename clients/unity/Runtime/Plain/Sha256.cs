using System;
using System.IO;
using System.Security.Cryptography;
using System.Text;
using System.Threading.Tasks;

namespace Capture2vr
{
    /// <summary>SHA-256 as 64 lower-case hexadecimal digits.</summary>
    public static class Sha256
    {
        public const int Digits = 64;
        private const int PieceBytes = 1 << 16;

        public static string Of(byte[] data)
        {
            using (var sha = SHA256.Create()) return Hex(sha.ComputeHash(data));
        }

        /// <summary>Of what is left of a stream, in pieces: a file need not fit into memory, nor its hashing into a frame.</summary>
        public static async Task<string> OfAsync(Stream stream)
        {
            var piece = new byte[PieceBytes];
            using (var sha = SHA256.Create())
            {
                int count;
                while ((count = stream.Read(piece, 0, piece.Length)) > 0)
                {
                    sha.TransformBlock(piece, 0, count, null, 0);
                    await Background.Pause().ConfigureAwait(Background.ComesBack);
                }
                sha.TransformFinalBlock(piece, 0, 0);
                return Hex(sha.Hash);
            }
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
