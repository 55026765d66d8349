using System;
using System.Collections.Generic;
using System.Linq;
using System.Text;
using System.Threading.Tasks;

namespace Capture2vr
{
    /// <summary>
    /// The signed root of a collection's catalogue: its shards, or where these are many, nodes that list shards or further
    /// nodes. It covers everything below it, since each lists its children by their hashes.
    /// </summary>
    public sealed class CollectionRoot
    {
        private const long Deepest = 8; // levels: 48 to the power of 9 assets

        public string Collection { get; private set; }
        public long Version { get; private set; }

        /// <summary>Rows in all, those of removed assets too.</summary>
        public long Count { get; private set; }

        /// <summary>Levels of nodes between it and the shards.</summary>
        public int Depth { get; private set; }

        /// <summary>Nodes, or at depth 0 shards, in the order of their keys.</summary>
        public IReadOnlyList<CataloguePart> Children { get; private set; }

        public static string ObjectName(string collection) => $"collections/{collection}/root.json";

        /// <summary>Where earlier releases of the server have it: a list of shards without nodes.</summary>
        public static string FlatName(string collection) => $"collections/{collection}/index.json";

        /// <summary>
        /// The root in its object, of either form, once its signature holds for one of the keys. Throws CaptureFault of classes
        /// SIGNATURE_*, KEY_UNKNOWN and CATALOGUE_*.
        /// </summary>
        /// <param name="name">of the object, for faults</param>
        /// <param name="keys">whose signature to believe, 32 bytes each; with none no signature is asked for</param>
        public static async Task<CollectionRoot> ReadAsync(byte[] data, string name, string collection, IReadOnlyList<byte[]> keys)
        {
            var envelope = Reading.Of(name, () => Json.Parse(Encoding.UTF8.GetString(data)));
            var text = Reading.Of(name, () => envelope.In("signed").Text());
            if (keys.Count > 0)
            {
                var signatures = Reading.Of(name, () => Signature.Believed(name, envelope.In("signatures").List(), keys));
                await Signature.Check(name, Encoding.UTF8.GetBytes(text), signatures).ConfigureAwait(Background.ComesBack);
            }
            var root = Reading.Of(name, () => From(Json.Parse(text)));
            if (root.Collection == collection) return root;
            throw new CaptureFault(CaptureFault.CatalogueOther, $"{name} is the catalogue of collection {root.Collection}");
        }

        private static CollectionRoot From(object document)
        {
            var collection = document.In("collection").Text();
            var root = new CollectionRoot { Collection = collection, Version = document.In("version").Whole() };
            if (document.Has("children")) root.ReadTree(document);
            else root.ReadFlat(document);
            return root;
        }

        private void ReadTree(object document)
        {
            var depth = document.In("depth").Whole();
            if (depth < 0 || depth > Deepest) throw new FormatException($"a tree of {depth} levels");
            Depth = (int)depth;
            Count = document.In("count").Whole();
            Children = CataloguePart.Children(document, Collection, Depth);
        }

        private void ReadFlat(object document)
        {
            Children = document.In("shards").List().Select(each => CataloguePart.Flat(each, Collection)).ToList();
            Count = Children.Sum(each => each.Count);
        }
    }

    /// <summary>A shard or a node as its parent lists it.</summary>
    public sealed class CataloguePart
    {
        private const long MostBytes = 16L << 20; // a hundred times what any writer has made

        private string _collection;

        public string Sha256 { get; private set; }
        public long Bytes { get; private set; }

        /// <summary>Rows in it or below it.</summary>
        public long Count { get; private set; }

        /// <summary>The key of its first row.</summary>
        public string First { get; private set; }

        /// <summary>0 for a shard; for a node one more than for its children.</summary>
        public int Height { get; private set; }

        /// <summary>Follows from collection and hash, whatever the parent may say.</summary>
        public string ObjectName => $"collections/{_collection}/{(Height == 0 ? "shard" : "node")}.{Sha256}.json";

        /// <summary>What a node lists, whose bytes have been checked by their hash.</summary>
        public IReadOnlyList<CataloguePart> Read(byte[] data)
        {
            return Reading.Of(ObjectName, () => Children(Json.Parse(Encoding.UTF8.GetString(data)), _collection, Height - 1));
        }

        /// <summary>Which of some parts has the key, if any has it.</summary>
        public static CataloguePart Of(IReadOnlyList<CataloguePart> parts, string key)
        {
            int low = 0, high = parts.Count; // all before low begin at the key or before it, all from high on behind it
            while (low < high)
            {
                var middle = (low + high) / 2;
                if (string.CompareOrdinal(parts[middle].First, key) <= 0) low = middle + 1;
                else high = middle;
            }
            return parts[Math.Max(0, low - 1)];
        }

        internal static IReadOnlyList<CataloguePart> Children(object document, string collection, int height)
        {
            var columns = document.In("columns").List().Select(each => each.Text()).ToList();
            return document.In("children").List().Select(each => From(columns, each.List(), collection, height)).ToList();
        }

        internal static CataloguePart Flat(object told, string collection)
        {
            return Of(collection, 0, Reading.Hash(told.In("sha256").Text()), told.In);
        }

        private static CataloguePart From(List<string> columns, List<object> cells, string collection, int height)
        {
            Func<string, object> cell = name => cells.At(columns.IndexOf(name));
            return Of(collection, height, Reading.HashOfBase64(cell("sha256").Text()), cell);
        }

        private static CataloguePart Of(string collection, int height, string sha256, Func<string, object> cell)
        {
            var bytes = cell("bytes").Whole();
            if (bytes < 1 || bytes > MostBytes) throw new FormatException($"a part of {bytes} bytes");
            return new CataloguePart
            {
                _collection = collection,
                Height = height,
                Sha256 = sha256,
                Bytes = bytes,
                Count = cell("count").Whole(),
                First = cell("first").Text(),
            };
        }
    }
}
