using System;
using System.Collections.Generic;
using System.IO;
using System.Linq;
using System.Threading.Tasks;

namespace Capture2vr
{
    /// <summary>
    /// Reads a collection as the server publishes it: index, rows, manifests, each checked by its hash, and the index by its
    /// signature where keys are given. Addressables' own catalogues are not signed; with this beside them, whoever changes
    /// one can only make assets disappear.
    /// </summary>
    public sealed class CollectionReader
    {
        private const long IndexBytes = 8L << 20; // a thousand times what 10,000 assets take

        private readonly string _baseUrl;
        private readonly string _collection;
        private readonly IReadOnlyList<byte[]> _keys;
        private readonly FileCache _cache;
        private readonly Versions _versions;
        private readonly Fetch _fetch;
        private readonly string _kept;

        /// <param name="keys">public keys, 32 bytes each; with none no signature is asked for</param>
        /// <param name="folder">where the last good index is kept, for times without a network</param>
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
            _kept = Path.Combine(folder, $"index.{collection}.json");
        }

        /// <summary>
        /// Throws CaptureFault unless this is the current version of the asset, and all files, by their SHA-256, belong to it. Does
        /// nothing without keys: what anybody may change proves nothing.
        /// </summary>
        public async Task Check(string key, long version, IEnumerable<string> files)
        {
            if (_keys.Count == 0) return;
            var row = await Retried(() => RowOnce(key)).ConfigureAwait(Background.ComesBack);
            // A number that nobody has signed would count as seen, and lock out all versions that come.
            if (row.Version != version)
            {
                throw NotSigned($"version {version} of asset {key} is not the one that the signed catalogue lists, {row.Version}");
            }
            var manifest = await ManifestOf(row).ConfigureAwait(Background.ComesBack);
            var signed = new HashSet<string>(manifest.Lods.Select(lod => lod.Sha256));
            if (!files.All(signed.Contains)) throw NotSigned($"a file of asset {key} is not among those that the signed catalogue lists");
        }

        /// <summary>All assets of the collection that are not removed, in the order of their keys.</summary>
        public Task<IReadOnlyList<AssetRow>> Rows() => Retried(RowsOnce);

        /// <summary>The manifest of the asset's current version.</summary>
        public Task<Manifest> ManifestOf(string key) => Retried(() => ManifestOnce(key));

        /// <summary>The asset's picture, a PNG of its four sides, the front at the top left; null where it has none.</summary>
        public async Task<byte[]> Preview(AssetRow row)
        {
            if (row.PreviewSha256 == "") return null;
            return await Content(row.PreviewName, row.PreviewSha256, -1).ConfigureAwait(Background.ComesBack);
        }

        /// <summary>A shard goes when enough newer ones have come; the index of this moment knows another.</summary>
        private static async Task<T> Retried<T>(Func<Task<T>> read)
        {
            try
            {
                return await read().ConfigureAwait(Background.ComesBack);
            }
            catch (CaptureFault fault) when (fault.Code == CaptureFault.FileMissing)
            {
                return await read().ConfigureAwait(Background.ComesBack);
            }
        }

        private async Task<IReadOnlyList<AssetRow>> RowsOnce()
        {
            var rows = new List<AssetRow>();
            var index = await Index().ConfigureAwait(Background.ComesBack);
            foreach (var shard in index.Shards)
            {
                rows.AddRange(await RowsOf(shard).ConfigureAwait(Background.ComesBack));
                await Background.Pause().ConfigureAwait(Background.ComesBack);
            }
            return rows.Where(row => !row.Removed).ToList();
        }

        private async Task<IReadOnlyList<AssetRow>> RowsOf(ShardName shard)
        {
            return AssetRow.Read(await Content(shard.ObjectName, shard.Sha256, shard.Bytes).ConfigureAwait(Background.ComesBack), shard);
        }

        private async Task<Manifest> ManifestOnce(string key)
        {
            return await ManifestOf(await RowOnce(key).ConfigureAwait(Background.ComesBack)).ConfigureAwait(Background.ComesBack);
        }

        private async Task<Manifest> ManifestOf(AssetRow row)
        {
            var manifest = await Content(row.ManifestName, row.ManifestSha256, -1).ConfigureAwait(Background.ComesBack);
            return Manifest.Read(manifest, row.ManifestName);
        }

        private async Task<AssetRow> RowOnce(string key)
        {
            var index = await Index().ConfigureAwait(Background.ComesBack);
            var shard = index.ShardOf(key) ?? throw Unknown(key);
            var rows = await RowsOf(shard).ConfigureAwait(Background.ComesBack);
            var row = rows.FirstOrDefault(each => each.Key == key) ?? throw Unknown(key);
            if (row.Removed) throw new CaptureFault(CaptureFault.AssetRemoved, $"asset {key} was removed");
            return row;
        }

        /// <summary>From the network; without one the last that was good, which is checked just the same.</summary>
        private async Task<CollectionIndex> Index()
        {
            byte[] data;
            try
            {
                data = await Fetched(CollectionIndex.ObjectName(_collection)).ConfigureAwait(Background.ComesBack);
            }
            catch (CaptureFault fault) when (fault.Code == CaptureFault.Unreachable && File.Exists(_kept))
            {
                return await Accepted(File.ReadAllBytes(_kept)).ConfigureAwait(Background.ComesBack);
            }
            var index = await Accepted(data).ConfigureAwait(Background.ComesBack);
            Keep(data);
            return index;
        }

        private async Task<CollectionIndex> Accepted(byte[] data)
        {
            var index = await CollectionIndex.ReadAsync(data, _collection, _keys).ConfigureAwait(Background.ComesBack);
            // Only now: a version that nobody has signed must not lock out those that come.
            _versions.Check("collection " + _collection, index.Version);
            return index;
        }

        private async Task<byte[]> Fetched(string name)
        {
            using (var memory = new MemoryStream())
            using (var bounded = new HashingStream(memory, IndexBytes, told => { }))
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

        private CaptureFault Unknown(string key)
        {
            return new CaptureFault(CaptureFault.AssetUnknown, $"collection {_collection} has no asset {key}");
        }
    }
}
