using System;
using System.Collections.Generic;
using System.IO;
using System.Linq;
using System.Threading.Tasks;

namespace Capture2vr
{
    /// <summary>
    /// Reads a collection as the server publishes it: root, nodes, rows, manifests, each checked by its hash, and the root by its
    /// signature where keys are given. Addressables' own catalogues are not signed; with this beside them, whoever changes
    /// one can only make assets disappear.
    /// </summary>
    public sealed class CollectionReader
    {
        private const long RootBytes = 8L << 20; // a thousand times what a root takes
        private const int Tries = 3;

        private readonly string _baseUrl;
        private readonly string _collection;
        private readonly IReadOnlyList<byte[]> _keys;
        private readonly FileCache _cache;
        private readonly Versions _versions;
        private readonly Fetch _fetch;
        private readonly string _kept;
        private Tuple<byte[], CollectionRoot> _accepted; // the last root: the same bytes need not be judged again

        /// <param name="keys">public keys, 32 bytes each; with none no signature is asked for</param>
        /// <param name="folder">where the last good root is kept, for times without a network</param>
        public CollectionReader(string baseUrl, string collection, IReadOnlyList<byte[]> keys, string folder, FileCache cache,
            Versions versions, Fetch fetch)
        {
            if (keys.Any(key => key.Length != Ed25519.KeyBytes)) throw new ArgumentException($"a public key has {Ed25519.KeyBytes} bytes");
            _baseUrl = baseUrl;
            _collection = collection;
            _keys = keys;
            _cache = cache;
            _versions = versions;
            _fetch = fetch;
            _kept = Path.Combine(folder, $"index.{collection}.json"); // so named when there was no tree: what a device has from then counts
        }

        /// <summary>
        /// Null where this is the current version of the asset and all files, by their SHA-256, belong to it; where the signed
        /// catalogue has a newer version, that one, since catalogues for Addressables are written up to half a minute after it.
        /// Throws CaptureFault for anything else. Null without keys too: what anybody may change proves nothing.
        /// </summary>
        public async Task<SignedAsset> Check(string key, long version, IEnumerable<string> files)
        {
            if (_keys.Count == 0) return null;
            var asset = (await Assets(new[] { key }).ConfigureAwait(Background.ComesBack)).Single();
            if (asset.Row.Version > version) return asset;
            // A number that nobody has signed would count as seen, and lock out all versions that come.
            if (asset.Row.Version != version)
            {
                throw NotSigned($"version {version} of asset {key} is not the one that the signed catalogue lists, {asset.Row.Version}");
            }
            var signed = new HashSet<string>(asset.Manifest.Lods.Select(lod => lod.Sha256));
            if (files.All(signed.Contains)) return null;
            throw NotSigned($"a file of asset {key} is not among those that the signed catalogue lists");
        }

        /// <summary>All assets of the collection that are not removed, in the order of their keys: reads the whole catalogue.</summary>
        public Task<IReadOnlyList<AssetRow>> Rows() => Rows(row => true);

        /// <summary>Those that are wanted; the others are forgotten at once.</summary>
        public Task<IReadOnlyList<AssetRow>> Rows(Func<AssetRow, bool> wanted) => Retried(async () =>
        {
            var tree = await Tree().ConfigureAwait(Background.ComesBack);
            return await tree.Rows(row => !row.Removed && wanted(row)).ConfigureAwait(Background.ComesBack);
        });

        /// <summary>Some assets, of which only the way to their rows is read. Throws CaptureFault ASSET_UNKNOWN, ASSET_REMOVED.</summary>
        public Task<IReadOnlyList<SignedAsset>> Assets(IReadOnlyCollection<string> keys) => Retried(() => AssetsOnce(keys));

        /// <summary>The manifest of the asset's current version.</summary>
        public async Task<Manifest> ManifestOf(string key)
        {
            return (await Assets(new[] { key }).ConfigureAwait(Background.ComesBack)).Single().Manifest;
        }

        /// <summary>
        /// What has become of assets since they were read, by their keys: null for those that are gone. Only what has changed is
        /// read; an asset whose new version cannot be had stays as it was.
        /// </summary>
        public Task<IReadOnlyDictionary<string, SignedAsset>> Changes(IReadOnlyCollection<SignedAsset> known) => Retried(() => ChangesOnce(known));

        /// <summary>The root of this moment; without a network the last that was good.</summary>
        public async Task<CollectionRoot> Root()
        {
            try
            {
                return await FetchedRoot().ConfigureAwait(Background.ComesBack);
            }
            catch (CaptureFault fault) when (fault.Code == CaptureFault.Unreachable && File.Exists(_kept))
            {
                return await Accepted(_kept, File.ReadAllBytes(_kept)).ConfigureAwait(Background.ComesBack);
            }
        }

        /// <summary>The asset's picture, a PNG of its four sides, the front at the top left; null where it has none.</summary>
        public async Task<byte[]> Preview(AssetRow row)
        {
            if (row.PreviewSha256 == "") return null;
            return await Content(row.PreviewName, row.PreviewSha256, -1).ConfigureAwait(Background.ComesBack);
        }

        /// <summary>A shard or a node goes when enough newer ones have come; the root of this moment knows another.</summary>
        private static async Task<T> Retried<T>(Func<Task<T>> read)
        {
            for (var left = Tries - 1; ; left--)
            {
                try
                {
                    return await read().ConfigureAwait(Background.ComesBack);
                }
                catch (CaptureFault fault) when (fault.Code == CaptureFault.FileMissing && left > 0)
                {
                    await Background.Pause().ConfigureAwait(Background.ComesBack);
                }
            }
        }

        private async Task<IReadOnlyList<SignedAsset>> AssetsOnce(IReadOnlyCollection<string> keys)
        {
            var tree = await Tree().ConfigureAwait(Background.ComesBack);
            var found = await tree.Find(keys.Distinct().ToDictionary(key => key, key => "")).ConfigureAwait(Background.ComesBack);
            foreach (var each in found) CheckThere(each);
            return await Several.Of(found, Signed).ConfigureAwait(Background.ComesBack);
        }

        private void CheckThere(FoundRow found)
        {
            if (found.Row == null) throw new CaptureFault(CaptureFault.AssetUnknown, $"collection {_collection} has no asset {found.Key}");
            if (found.Row.Removed) throw new CaptureFault(CaptureFault.AssetRemoved, $"asset {found.Key} was removed");
        }

        private async Task<SignedAsset> Signed(FoundRow found)
        {
            return new SignedAsset(found, await ManifestOf(found.Row).ConfigureAwait(Background.ComesBack));
        }

        private async Task<IReadOnlyDictionary<string, SignedAsset>> ChangesOnce(IReadOnlyCollection<SignedAsset> known)
        {
            var root = await Root().ConfigureAwait(Background.ComesBack);
            var old = known.Where(each => each.CatalogueVersion < root.Version).ToDictionary(each => each.Row.Key);
            if (old.Count == 0) return old;
            var found = await TreeOf(root).Find(old.ToDictionary(each => each.Key, each => each.Value.Shard)).ConfigureAwait(Background.ComesBack);
            var now = await Several.Of(found, each => Changed(old[each.Key], each)).ConfigureAwait(Background.ComesBack);
            return found.Select((each, place) => place).ToDictionary(place => found[place].Key, place => now[place]);
        }

        private async Task<SignedAsset> Changed(SignedAsset old, FoundRow found)
        {
            if (found.Shard == old.Shard) return new SignedAsset(new FoundRow(found.Key, old.Row, found.Shard, found.Version), old.Manifest);
            if (found.Row == null || found.Row.Removed) return null;
            if (found.Row.ManifestSha256 == old.Row.ManifestSha256) return new SignedAsset(found, old.Manifest);
            try
            {
                return await Signed(found).ConfigureAwait(Background.ComesBack);
            }
            catch (CaptureFault fault) when (fault.Code != CaptureFault.Unreachable)
            {
                return old; // of an older catalogue still, so the next look tries again
            }
        }

        private async Task<Manifest> ManifestOf(AssetRow row)
        {
            var manifest = await Content(row.ManifestName, row.ManifestSha256, -1).ConfigureAwait(Background.ComesBack);
            return Manifest.Read(manifest, row.ManifestName);
        }

        private async Task<CatalogueTree> Tree() => TreeOf(await Root().ConfigureAwait(Background.ComesBack));

        private CatalogueTree TreeOf(CollectionRoot root) => new CatalogueTree(root, part => Content(part.ObjectName, part.Sha256, part.Bytes));

        /// <summary>A store of an earlier release has a flat list of shards only. Buckets that nobody may list say refused for missing.</summary>
        private async Task<CollectionRoot> FetchedRoot()
        {
            try
            {
                return await FetchedRoot(CollectionRoot.ObjectName(_collection)).ConfigureAwait(Background.ComesBack);
            }
            catch (CaptureFault fault) when (fault.Code == CaptureFault.FileMissing || fault.Code == CaptureFault.AccessRefused)
            {
                return await FetchedRoot(CollectionRoot.FlatName(_collection)).ConfigureAwait(Background.ComesBack);
            }
        }

        private async Task<CollectionRoot> FetchedRoot(string name)
        {
            var data = await Fetched(name).ConfigureAwait(Background.ComesBack);
            var last = _accepted;
            var root = await Accepted(name, data).ConfigureAwait(Background.ComesBack);
            if (_accepted != last) Keep(data);
            return root;
        }

        private async Task<CollectionRoot> Accepted(string name, byte[] data)
        {
            var last = _accepted;
            if (last == null || !last.Item1.SequenceEqual(data))
            {
                last = Tuple.Create(data, await CollectionRoot.ReadAsync(data, name, _collection, _keys).ConfigureAwait(Background.ComesBack));
            }
            // Only now: a version that nobody has signed must not lock out those that come.
            _versions.Check("collection " + _collection, last.Item2.Version);
            _accepted = last;
            return last.Item2;
        }

        private async Task<byte[]> Fetched(string name)
        {
            using (var memory = new MemoryStream())
            using (var bounded = new HashingStream(memory, RootBytes, told => { }))
            {
                await _fetch($"{_baseUrl}/{name}", bounded).ConfigureAwait(Background.ComesBack);
                return memory.ToArray();
            }
        }

        private void Keep(byte[] data)
        {
            var part = $"{_kept}.{Guid.NewGuid():N}.part";
            try
            {
                File.WriteAllBytes(part, data);
                Storage.Replace(part, _kept);
            }
            catch (Exception fault) when (fault is IOException || fault is UnauthorizedAccessException)
            {
                // A full disk, or another check that was faster: only a start without a network would miss it.
            }
        }

        private async Task<byte[]> Content(string name, string sha256, long size)
        {
            var path = await _cache.Load($"{_baseUrl}/{name}", sha256, size).Task.ConfigureAwait(Background.ComesBack);
            try
            {
                return File.ReadAllBytes(path);
            }
            finally
            {
                _cache.Release(sha256);
            }
        }

        private static CaptureFault NotSigned(string reason)
        {
            return new CaptureFault(CaptureFault.FileNotSigned, reason,
                "The Addressables catalogue is older or newer than it, or was tampered with; update the catalogues");
        }
    }
}
