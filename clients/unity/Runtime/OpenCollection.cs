using System;
using System.Collections.Generic;
using System.IO;
using System.Linq;
using System.Text;
using System.Threading.Tasks;
using UnityEngine.ResourceManagement.ResourceLocations;

namespace Capture2vr
{
    /// <summary>A collection that is open: where it is, whose signature it bears, what of it is on the device.</summary>
    public sealed class OpenCollection
    {
        private const int ProgressMs = 100; // between two reports

        private readonly AccessHeaders _access;
        private readonly string _folder;
        private readonly Versions _versions;
        private readonly List<byte[]> _keys = new List<byte[]>();
        private readonly AssetFinder _finder;
        private Task _work; // opening or updating

        internal OpenCollection(AccessHeaders access, string name)
        {
            _access = access;
            Name = name;
            // Of its own: two servers may have collections of the same name.
            var identity = Sha256.Of(Encoding.UTF8.GetBytes($"{BaseUrl} {name}")).Substring(0, 16);
            _folder = Path.Combine(Catalogue.Folder, $"collection-{identity}");
            Directory.CreateDirectory(_folder);
            _versions = new Versions(Path.Combine(_folder, "versions.txt"));
            var signed = new SignedLocator($"{BaseUrl}/{CollectionRoot.ObjectName(name)}");
            _finder = new AssetFinder(name, new UnityCatalogue(BaseUrl, name, _folder), signed);
        }

        public string Name { get; }

        /// <summary>Below which address its objects are.</summary>
        public string BaseUrl => _access.BaseUrl;

        /// <summary>Keys of its assets, sorted. Throws CaptureFault COLLECTION_LARGE where these are too many: KeysAsync.</summary>
        public IReadOnlyList<string> Keys => _finder.Keys;

        /// <summary>Keys of the assets that bear a label, sorted. Throws CaptureFault COLLECTION_LARGE: WithLabelAsync.</summary>
        public IReadOnlyList<string> WithLabel(string label) => _finder.WithLabel(label);

        /// <summary>Keys of its assets, however many, sorted. Of a large collection it reads the whole catalogue. Throws CaptureFault.</summary>
        public Task<IReadOnlyList<string>> KeysAsync() => _finder.IsListed ? Task.FromResult(Keys) : KeysOf(row => true);

        /// <summary>Keys of the assets that bear a label, found as KeysAsync finds them.</summary>
        public Task<IReadOnlyList<string>> WithLabelAsync(string label)
        {
            return _finder.IsListed ? Task.FromResult(WithLabel(label)) : KeysOf(row => row.Labels.Contains(label));
        }

        /// <summary>
        /// Find assets, so that Addressables can load captures/&lt;key&gt;. CapturedAsset and DownloadAsync do so themselves. What
        /// is known is not asked for again: UpdateAsync looks for newer versions. Several keys in one call share the way. Throws
        /// CaptureFault ASSET_UNKNOWN, ASSET_REMOVED and those of network and catalogue.
        /// </summary>
        public Task EnsureAsync(params string[] keys) => _finder.EnsureAsync(keys);

        /// <summary>
        /// Names, labels and pictures of its assets, for people to choose from: asked for anew each time, and without a network
        /// as they were. Throws CaptureFault.
        /// </summary>
        public Task<IReadOnlyList<AssetRow>> RowsAsync()
        {
            var reader = _finder.Reader;
            return Background.Run(() => reader.Rows());
        }

        /// <summary>
        /// The picture of an asset as a PNG, its hash checked: four sides of it, the front at the top left. Null where it has
        /// none. Throws CaptureFault.
        /// </summary>
        public Task<byte[]> PreviewAsync(AssetRow row)
        {
            var reader = _finder.Reader;
            return Background.Run(() => reader.Preview(row));
        }

        /// <summary>Take the newer catalogue if there is one. Without a network, what there is stays.</summary>
        public Task UpdateAsync()
        {
            if (_work == null || _work.IsCompleted) _work = _finder.UpdateAsync();
            return _work;
        }

        /// <summary>
        /// Bring an asset onto the device without showing it. Throws CaptureFault for the first file that cannot be had; what
        /// has come stays.
        /// </summary>
        /// <param name="progress">is told the share that has come, from 0 to 1, on the thread of the caller</param>
        public async Task DownloadAsync(string key, IProgress<float> progress = null)
        {
            var files = Files(await SignedAsync(await LocateAsync(key)));
            var downloads = files.Select(each => Catalogue.Cache.Load(each.Url, each.Sha256, each.Size)).ToList();
            var all = Task.WhenAll(downloads.Select(each => each.Task));
            try
            {
                while (await Task.WhenAny(all, Background.Delay(ProgressMs)) != all) progress?.Report(Share(downloads));
                await all;
                progress?.Report(1);
            }
            finally
            {
                for (var place = 0; place < files.Count; place++)
                {
                    if (downloads[place].Task.Status == TaskStatus.RanToCompletion) Catalogue.Cache.Release(files[place].Sha256);
                }
            }
        }

        /// <summary>
        /// Whether all files of an asset's current version are on the device. Of a large collection EnsureAsync comes first.
        /// Throws CaptureFault ASSET_UNKNOWN.
        /// </summary>
        public bool IsCached(string key) => RemainingBytes(key) == 0;

        /// <summary>Bytes of an asset that are not on the device; otherwise as IsCached.</summary>
        public long RemainingBytes(string key)
        {
            return Files(_finder.Located(key)).Where(each => !Catalogue.Cache.Has(each.Sha256, each.Size)).Sum(each => each.Size);
        }

        /// <summary>
        /// Remove an asset's files from the device, and return how many bytes that freed; what is shown stays. Otherwise as
        /// IsCached.
        /// </summary>
        public long Clear(string key)
        {
            return Files(_finder.Located(key)).Where(each => Catalogue.Cache.Remove(each.Sha256)).Sum(each => each.Size);
        }

        /// <summary>Ask for a signature by one of these public keys too, of 32 bytes each. No key is ever dropped.</summary>
        internal void Believe(IEnumerable<byte[]> keys)
        {
            var more = keys.Where(key => !_keys.Any(known => known.SequenceEqual(key))).ToList();
            if (more.Count == 0 && _finder.Reader != null) return;
            _keys.AddRange(more);
            _finder.Reader = new CollectionReader(BaseUrl, Name, _keys.ToList(), _folder, Catalogue.Cache, _versions, Catalogue.FetchAsync);
        }

        internal async Task OpenAsync()
        {
            while (_work != null && !_work.IsCompleted) await _work;
            _work = _finder.IsOpen ? _finder.UpdateAsync() : _finder.OpenAsync();
            await _work;
        }

        /// <summary>Where an asset is, which is looked up where that is not known yet. Throws CaptureFault.</summary>
        internal async Task<IResourceLocation> LocateAsync(string key)
        {
            await EnsureAsync(key);
            return _finder.Located(key);
        }

        internal bool Has(IResourceLocation location) => _finder.Has(location);

        /// <summary>The files of an asset, finest first.</summary>
        internal IReadOnlyList<GlbFile> Files(IResourceLocation asset)
        {
            return asset.Dependencies.Select(each => GlbFile.Of(each, this)).OrderBy(each => each.Level).ToList();
        }

        /// <summary>
        /// What to show for a location: the same, or the newer version of the signed catalogue. Signature before version: what
        /// nobody signed must not count as seen. Throws CaptureFault.
        /// </summary>
        internal async Task<IResourceLocation> CheckAsync(IResourceLocation asset)
        {
            var signed = await SignedAsync(asset);
            _versions.Check(signed.PrimaryKey, AssetLocation.Version(signed));
            return signed;
        }

        private Task<IResourceLocation> SignedAsync(IResourceLocation asset)
        {
            return _finder.SignedAsync(asset, Files(asset).Select(each => each.Sha256).ToList());
        }

        private async Task<IReadOnlyList<string>> KeysOf(Func<AssetRow, bool> wanted)
        {
            var reader = _finder.Reader;
            return (await Background.Run(() => reader.Rows(wanted))).Select(each => each.Key).ToList();
        }

        private static float Share(IReadOnlyList<Download> downloads)
        {
            var total = downloads.Sum(each => Math.Max(0, each.Size));
            var come = downloads.Sum(each => each.Task.IsCompleted ? Math.Max(0, each.Size) : each.Received);
            return total > 0 ? (float)come / total : 0;
        }
    }
}
