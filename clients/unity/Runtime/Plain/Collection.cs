using System;
using System.Collections.Generic;
using System.Linq;
using System.Text;
using System.Threading.Tasks;

namespace Capture2vr
{
    /// <summary>An asset as its collection knows it.</summary>
    public sealed class AssetRow
    {
        public string Key { get; private set; }
        public string Label { get; private set; }
        public long Version { get; private set; }
        public bool Removed { get; private set; }
        public string ManifestSha256 { get; private set; }

        /// <summary>Words to find it by.</summary>
        public IReadOnlyList<string> Labels { get; private set; }

        /// <summary>The hash of its picture, or "".</summary>
        public string PreviewSha256 { get; private set; }

        public string PreviewName => $"assets/{Key}/preview.{PreviewSha256}.png";

        public string ManifestName => $"assets/{Key}/manifest.{ManifestSha256}.json";

        /// <summary>All rows of a shard, whose bytes have been checked by their hash.</summary>
        public static IReadOnlyList<AssetRow> Read(byte[] data, CataloguePart shard)
        {
            return Reading.Of(shard.ObjectName, () =>
            {
                var document = Json.Parse(Encoding.UTF8.GetString(data));
                var columns = document.In("columns").List().Select(each => each.Text()).ToList();
                var words = document.In("words").List();
                return document.In("rows").List().Select(row => From(columns, words, row.List())).ToList();
            });
        }

        private static AssetRow From(List<string> columns, List<object> words, List<object> cells)
        {
            Func<string, object> cell = name => cells.At(columns.IndexOf(name));
            return new AssetRow
            {
                Key = cell("key").Text(),
                Label = cell("label").Text(),
                Version = cell("version").Whole(),
                Removed = words.At(cell("state").Whole()).Text() == "removed",
                ManifestSha256 = Reading.HashOfBase64(cell("manifest").Text()),
                Labels = cell("labels").List().Select(place => words.At(place.Whole()).Text()).ToList(),
                PreviewSha256 = cell("preview").Text() == "" ? "" : Reading.HashOfBase64(cell("preview").Text()),
            };
        }
    }

    /// <summary>What one version of an asset is made of.</summary>
    public sealed class Manifest
    {
        /// <summary>Levels of detail, the finest first.</summary>
        public IReadOnlyList<LodFile> Lods { get; private set; }

        /// <summary>metric, estimated or unknown.</summary>
        public string ScaleConfidence { get; private set; }

        public static Manifest Read(byte[] data, string name)
        {
            return Reading.Of(name, () =>
            {
                var document = Json.Parse(Encoding.UTF8.GetString(data));
                return new Manifest
                {
                    Lods = document.In("lods").List().Select(LodFile.From).OrderBy(lod => lod.Level).ToList(),
                    ScaleConfidence = document.In("scale_confidence") as string ?? "unknown",
                };
            });
        }
    }

    /// <summary>A file of a manifest: one level of detail, 0 being the finest.</summary>
    public sealed class LodFile
    {
        public long Level { get; private set; }
        public string ObjectName { get; private set; }
        public string Sha256 { get; private set; }
        public long Bytes { get; private set; }

        internal static LodFile From(object told)
        {
            return new LodFile
            {
                Level = told.In("level").Whole(),
                ObjectName = told.In("name").Text(),
                Sha256 = Reading.Hash(told.In("sha256").Text()),
                Bytes = told.In("bytes").Whole(),
            };
        }
    }

    /// <summary>A signature by a key that this app believes.</summary>
    internal sealed class Signature
    {
        private const int IdDigits = 16; // of the SHA-256 of a public key

        private byte[] Key { get; set; }
        private byte[] Bytes { get; set; }

        /// <summary>Those of an index that are by one of the keys. Throws CaptureFault SIGNATURE_MISSING and KEY_UNKNOWN.</summary>
        public static List<Signature> Believed(string name, List<object> told, IReadOnlyList<byte[]> keys)
        {
            if (told.Count == 0) throw new CaptureFault(CaptureFault.SignatureMissing, $"{name}: nobody has signed it");
            var known = new Dictionary<string, byte[]>();
            foreach (var key in keys) known[Sha256.Of(key).Substring(0, IdDigits)] = key;
            var mine = told.Where(each => known.ContainsKey(each.In("key").Text())).ToList();
            if (mine.Count > 0) return mine.Select(each => From(each, known)).ToList();
            var ids = string.Join(", ", told.Select(each => each.In("key").Text()));
            throw new CaptureFault(CaptureFault.KeyUnknown, $"{name} is signed by {ids}, which this app does not believe");
        }

        /// <summary>That one of them is of the text. One suffices: while keys are exchanged there are two.</summary>
        public static async Task Check(string name, byte[] text, List<Signature> signatures)
        {
            foreach (var each in signatures)
            {
                if (await Ed25519.VerifyAsync(each.Key, text, each.Bytes).ConfigureAwait(Background.ComesBack)) return;
            }
            throw new CaptureFault(CaptureFault.SignatureWrong, $"{name}: the signature is not that of this text",
                "The catalogue was damaged or tampered with, and nothing of it is shown");
        }

        private static Signature From(object told, Dictionary<string, byte[]> known)
        {
            return new Signature { Key = known[told.In("key").Text()], Bytes = Convert.FromBase64String(told.In("ed25519").Text()) };
        }
    }

    internal static class Reading
    {
        /// <summary>Whatever is wrong with the bytes becomes CATALOGUE_TRUNCATED, with the name of the object.</summary>
        public static T Of<T>(string name, Func<T> read)
        {
            try
            {
                return read();
            }
            catch (FormatException fault)
            {
                throw new CaptureFault(CaptureFault.CatalogueTruncated, $"{name} is no whole catalogue: {fault.Message}", "", fault);
            }
        }

        public static string Hash(string text)
        {
            return Sha256.IsHash(text) ? text : throw new FormatException($"{text} is no SHA-256");
        }

        /// <summary>A SHA-256 as rows and nodes have it: 43 letters of base64url, without padding.</summary>
        public static string HashOfBase64(string text)
        {
            var padded = text.Replace('-', '+').Replace('_', '/') + new string('=', (4 - text.Length % 4) % 4);
            return Hash(Sha256.Hex(Convert.FromBase64String(padded)));
        }
    }
}
