using System;
using System.Collections.Generic;
using System.Linq;
using System.Threading.Tasks;

namespace Capture2vr
{
    /// <summary>What a catalogue says of a key.</summary>
    public sealed class FoundRow
    {
        internal FoundRow(string key, AssetRow row, string shard, long version)
        {
            Key = key;
            Row = row;
            Shard = shard;
            Version = version;
        }

        public string Key { get; }

        /// <summary>Null where it has none, or where nobody looked into the shard.</summary>
        public AssetRow Row { get; }

        /// <summary>The hash of the shard that has the row, or would have it.</summary>
        public string Shard { get; }

        /// <summary>Of the catalogue, not of the asset.</summary>
        public long Version { get; }
    }

    /// <summary>Reads what is below a root, several parts at once: for some keys only the parts on the way to their rows.</summary>
    internal sealed class CatalogueTree
    {
        private readonly CollectionRoot _root;
        private readonly Func<CataloguePart, Task<byte[]>> _read;

        /// <param name="read">the bytes of a part, checked by its hash</param>
        public CatalogueTree(CollectionRoot root, Func<CataloguePart, Task<byte[]>> read)
        {
            _root = root;
            _read = read;
        }

        /// <summary>All rows that are wanted, in the order of their keys; every part is read.</summary>
        public async Task<IReadOnlyList<AssetRow>> Rows(Func<AssetRow, bool> wanted)
        {
            var parts = _root.Children;
            for (var height = _root.Depth; height > 0; height--)
            {
                parts = Joined(await Several.Of(parts, Children).ConfigureAwait(Background.ComesBack));
            }
            return Joined(await Several.Of(parts, part => Rows(part, wanted)).ConfigureAwait(Background.ComesBack));
        }

        /// <summary>The rows of some keys.</summary>
        /// <param name="shards">keys, each with the hash of the shard that its row is known from, which is then not read; or ""</param>
        public async Task<IReadOnlyList<FoundRow>> Find(IReadOnlyDictionary<string, string> shards)
        {
            var branches = Branch.Of(_root.Children, shards.Keys);
            for (var height = _root.Depth; height > 0; height--)
            {
                branches = Joined(await Several.Of(branches, Grow).ConfigureAwait(Background.ComesBack));
            }
            var found = Joined(await Several.Of(branches, each => Found(each, shards)).ConfigureAwait(Background.ComesBack));
            var nowhere = shards.Keys.Except(found.Select(each => each.Key)); // below a part without children
            return found.Concat(nowhere.Select(key => new FoundRow(key, null, "", _root.Version))).ToList();
        }

        private async Task<IReadOnlyList<Branch>> Grow(Branch branch)
        {
            return Branch.Of(await Children(branch.Part).ConfigureAwait(Background.ComesBack), branch.Keys);
        }

        private async Task<IReadOnlyList<FoundRow>> Found(Branch branch, IReadOnlyDictionary<string, string> shards)
        {
            var shard = branch.Part.Sha256;
            var rows = new Dictionary<string, AssetRow>();
            if (branch.Keys.Any(key => shards[key] != shard))
            {
                foreach (var row in await Rows(branch.Part, row => true).ConfigureAwait(Background.ComesBack)) rows[row.Key] = row;
            }
            return branch.Keys.Select(key => new FoundRow(key, rows.TryGetValue(key, out var row) ? row : null, shard, _root.Version)).ToList();
        }

        private async Task<IReadOnlyList<CataloguePart>> Children(CataloguePart node)
        {
            return node.Read(await _read(node).ConfigureAwait(Background.ComesBack));
        }

        private async Task<IReadOnlyList<AssetRow>> Rows(CataloguePart shard, Func<AssetRow, bool> wanted)
        {
            return AssetRow.Read(await _read(shard).ConfigureAwait(Background.ComesBack), shard).Where(wanted).ToList();
        }

        private static IReadOnlyList<T> Joined<T>(IEnumerable<IReadOnlyList<T>> lists) => lists.SelectMany(each => each).ToList();

        /// <summary>A part with those of the keys whose rows are in it or below it.</summary>
        private sealed class Branch
        {
            public CataloguePart Part { get; private set; }
            public IReadOnlyList<string> Keys { get; private set; }

            public static IReadOnlyList<Branch> Of(IReadOnlyList<CataloguePart> parts, IEnumerable<string> keys)
            {
                if (parts.Count == 0) return new Branch[0];
                return keys.GroupBy(key => CataloguePart.Of(parts, key)).Select(each => new Branch { Part = each.Key, Keys = each.ToList() }).ToList();
            }
        }
    }
}
