using System;
using System.Linq;
using System.Numerics;
using System.Security.Cryptography;
using System.Threading.Tasks;

namespace Capture2vr
{
    /// <summary>
    /// Checks Ed25519 signatures (RFC 8032, 5.1.7), which .NET has no class for. Curve: -x² + y² = 1 + d·x²·y² over the
    /// numbers modulo p = 2^255 - 19; B is its base point, of prime order l. It takes some ten milliseconds, several times as
    /// many in a browser, where frames pass meanwhile. It hides nothing from somebody who measures: verifying knows no secrets.
    /// </summary>
    public static class Ed25519
    {
        public const int KeyBytes = 32;
        private const int SignatureBytes = 64;

        private static readonly BigInteger P = BigInteger.Pow(2, 255) - 19;
        private static readonly BigInteger L = BigInteger.Pow(2, 252) + BigInteger.Parse("27742317777372353535851937790883648493");
        private static readonly BigInteger D = Mod(-121665 * Inverse(121666));
        private static readonly BigInteger RootOfMinusOne = BigInteger.ModPow(2, (P - 1) / 4, P);
        private static readonly Point Zero = new Point(0, 1);
        private static readonly Point Base = BasePoint();

        /// <summary>Whether [S]B = R + [k]A for the key A, the signature R, S and k = SHA-512(R, A, message).</summary>
        public static async Task<bool> VerifyAsync(byte[] key, byte[] message, byte[] signature)
        {
            if (key.Length != KeyBytes || signature.Length != SignatureBytes) return false;
            var s = Number(signature.Skip(32));
            if (s >= L) return false;
            Point a, r; // declared here: Mono's compiler fails on those of a private type that are declared as out
            if (!Decode(key, out a) || !Decode(signature.Take(32).ToArray(), out r)) return false;
            var k = Number(Sha512(signature.Take(32).Concat(key).Concat(message).ToArray())) % L;
            var left = await Times(s, Base).ConfigureAwait(Background.ComesBack);
            var right = await Times(k, a).ConfigureAwait(Background.ComesBack);
            return left.Same(Add(r, right));
        }

        /// <summary>A point in homogeneous coordinates: x = X/Z, y = Y/Z, T = X·Y/Z.</summary>
        private readonly struct Point
        {
            public readonly BigInteger X, Y, Z, T;

            public Point(BigInteger x, BigInteger y) : this(x, y, 1, Mod(x * y))
            {
            }

            public Point(BigInteger x, BigInteger y, BigInteger z, BigInteger t)
            {
                X = x;
                Y = y;
                Z = z;
                T = t;
            }

            public bool Same(Point other) => Mod(X * other.Z - other.X * Z).IsZero && Mod(Y * other.Z - other.Y * Z).IsZero;
        }

        /// <summary>The sum of two points, also of equal ones (RFC 8032, 5.1.4).</summary>
        private static Point Add(Point one, Point two)
        {
            var a = Mod((one.Y - one.X) * (two.Y - two.X));
            var b = Mod((one.Y + one.X) * (two.Y + two.X));
            var c = Mod(2 * one.T * D % P * two.T);
            var d = Mod(2 * one.Z * two.Z);
            BigInteger e = b - a, f = d - c, g = d + c, h = b + a;
            return new Point(Mod(e * f), Mod(g * h), Mod(f * g), Mod(e * h));
        }

        private static async Task<Point> Times(BigInteger factor, Point point)
        {
            var sum = Zero;
            for (; !factor.IsZero; factor >>= 1)
            {
                if (!factor.IsEven) sum = Add(sum, point);
                point = Add(point, point);
                await Background.Pause().ConfigureAwait(Background.ComesBack);
            }
            return sum;
        }

        /// <summary>y in 255 bits and the lowest bit of x above them (RFC 8032, 5.1.3); false for no point.</summary>
        private static bool Decode(byte[] bytes, out Point point)
        {
            var number = Number(bytes);
            var odd = !(number >> 255).IsZero;
            var y = number & (BigInteger.Pow(2, 255) - 1);
            point = Zero;
            if (y >= P || !TryX(y, odd, out var x)) return false;
            point = new Point(x, y);
            return true;
        }

        /// <summary>x² = (y² - 1) / (d·y² + 1), of whose two roots one is odd.</summary>
        private static bool TryX(BigInteger y, bool odd, out BigInteger x)
        {
            var square = Mod((y * y - 1) * Inverse(Mod(D * y * y + 1)));
            x = BigInteger.ModPow(square, (P + 3) / 8, P);
            if (!Mod(x * x - square).IsZero) x = Mod(x * RootOfMinusOne);
            if (!Mod(x * x - square).IsZero || (x.IsZero && odd)) return false;
            if (x.IsEven == odd) x = P - x;
            return true;
        }

        private static Point BasePoint()
        {
            var y = Mod(4 * Inverse(5));
            TryX(y, false, out var x);
            return new Point(x, y);
        }

        private static BigInteger Inverse(BigInteger number) => BigInteger.ModPow(number, P - 2, P);

        private static BigInteger Mod(BigInteger number)
        {
            var rest = number % P;
            return rest.Sign < 0 ? rest + P : rest;
        }

        /// <summary>Little-endian; the zero behind it keeps the sign plus.</summary>
        private static BigInteger Number(System.Collections.Generic.IEnumerable<byte> bytes)
        {
            return new BigInteger(bytes.Concat(new byte[] { 0 }).ToArray());
        }

        private static byte[] Sha512(byte[] data)
        {
            using (var sha = SHA512.Create()) return sha.ComputeHash(data);
        }
    }
}
