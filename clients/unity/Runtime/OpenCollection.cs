using System;
using System.Collections.Generic;
using System.IO;
using System.Linq;
using System.Text;
using System.Threading.Tasks;
using UnityEngine;
using UnityEngine.AddressableAssets;
using UnityEngine.AddressableAssets.ResourceLocators;
using UnityEngine.ResourceManagement.AsyncOperations;
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
        private CollectionReader _reader;
        private IResourceLocator _locator;
        private IResourceLocator _before; // of the last update: who has one of its locations may still load it
        private string _hash;
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
        }

        public string Name { get; }

        /// <summary>Below which address its objects are.</summary>
        public string BaseUrl => _access.BaseUrl;

        /// <summary>Keys of its assets, sorted.</summary>
        public IReadOnlyList<string> Keys => AssetsAt(_locator.Keys.OfType<string>().Where(AssetLocation.IsAssets));

        /// <summary>Keys of the assets that bear a label, sorted.</summary>
        public IReadOnlyList<string> WithLabel(string label) => AssetsAt(new[] { label });

        /// <summary>
        /// Names, labels and pictures of its assets, for people to choose from: asked for anew each time, and without a network
        /// as they were. Throws CaptureFault.
        /// </summary>
        public Task<IReadOnlyList<AssetRow>> RowsAsync()
        {
            var reader = _reader;
            return Background.Run(() => reader.Rows());
        }

        /// <summary>
        /// The picture of an asset as a PNG, its hash checked: four sides of it, the front at the top left. Null where it has
        /// none. Throws CaptureFault.
        /// </summary>
        public Task<byte[]> PreviewAsync(AssetRow row)
        {
            var reader = _reader;
            return Background.Run(() => reader.Preview(row));
        }

        /// <summary>Take the newer catalogue if there is one. Without a network, what there is stays.</summary>
        public Task UpdateAsync()
        {
            if (_work == null || _work.IsCompleted) _work = Update();
            return _work;
        }

        /// <summary>
        /// Bring an asset onto the device without showing it. Throws CaptureFault for the first file that cannot be had; what
        /// has come stays.
        /// </summary>
        /// <param name="progress">is told the share that has come, from 0 to 1, on the thread of the caller</param>
        public async Task DownloadAsync(string key, IProgress<float> progress = null)
        {
            var asset = Locate(key);
            var files = Files(asset);
            await CheckSignature(asset, files);
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

        /// <summary>Whether all files of an asset's current version are on the device. Throws CaptureFault ASSET_UNKNOWN.</summary>
        public bool IsCached(string key) => RemainingBytes(key) == 0;

        /// <summary>Bytes of an asset that are not on the device. Throws CaptureFault ASSET_UNKNOWN.</summary>
        public long RemainingBytes(string key)
        {
            return Files(Locate(key)).Where(each => !Catalogue.Cache.Has(each.Sha256, each.Size)).Sum(each => each.Size);
        }

        /// <summary>
        /// Remove an asset's files from the device, and return how many bytes that freed; what is shown stays. Throws
        /// CaptureFault ASSET_UNKNOWN.
        /// </summary>
        public long Clear(string key)
        {
            return Files(Locate(key)).Where(each => Catalogue.Cache.Remove(each.Sha256)).Sum(each => each.Size);
        }

        /// <summary>Ask for a signature by one of these public keys too, of 32 bytes each. No key is ever dropped.</summary>
        internal void Believe(IEnumerable<byte[]> keys)
        {
            _keys.AddRange(keys.Where(key => !_keys.Any(known => known.SequenceEqual(key))));
            _reader = new CollectionReader(BaseUrl, Name, _keys.ToList(), _folder, Catalogue.Cache, _versions, Catalogue.FetchAsync);
        }

        internal async Task OpenAsync()
        {
            while (_work != null && !_work.IsCompleted) await _work;
            _work = _locator == null ? Load() : Update();
            await _work;
        }

        /// <summary>Where an asset is. Throws CaptureFault ASSET_UNKNOWN.</summary>
        internal IResourceLocation Locate(string key)
        {
            return AssetOf(_locator, AssetLocation.Prefix + key).FirstOrDefault()
                ?? throw new CaptureFault(CaptureFault.AssetUnknown, $"collection {Name} has no asset {key}");
        }

        internal bool Has(IResourceLocation location)
        {
            return new[] { _locator, _before }.Any(locator => locator != null
                && locator.Locate(location.PrimaryKey, null, out var found) && found.Any(each => IsSame(each, location)));
        }

        /// <summary>The files of an asset, finest first.</summary>
        internal IReadOnlyList<GlbFile> Files(IResourceLocation asset)
        {
            return asset.Dependencies.Select(each => GlbFile.Of(each, this)).OrderBy(each => each.Level).ToList();
        }

        /// <summary>Signature before version: what nobody signed must not count as seen. Throws CaptureFault.</summary>
        internal async Task Check(IResourceLocation asset, IReadOnlyList<GlbFile> files)
        {
            await CheckSignature(asset, files);
            _versions.Check(asset.PrimaryKey, AssetLocation.Version(asset));
        }

        private Task CheckSignature(IResourceLocation asset, IReadOnlyList<GlbFile> files)
        {
            var key = AssetLocation.Key(asset);
            var version = AssetLocation.Version(asset);
            var hashes = files.Select(each => each.Sha256).ToList();
            var reader = _reader;
            return Background.Run(() => reader.Check(key, version, hashes));
        }

        private async Task Load()
        {
            // From 4.0 on, Addressables has no reader of catalogues before it is initialised. Whether the app has catalogues
            // of its own to find then is not our affair.
            var starting = Addressables.InitializeAsync(false);
            await Completion.Of(starting);
            Addressables.Release(starting);
            string hash = null;
            CaptureFault unreachable = null;
            try
            {
                hash = await Hash();
            }
            catch (CaptureFault fault) when (fault.Code == CaptureFault.Unreachable)
            {
                unreachable = fault; // the device may have the catalogue
            }
            var loading = Addressables.LoadContentCatalogAsync(Address(Catalogue.FileName), false);
            await Completion.Of(loading);
            var cause = loading.OperationException;
            if (loading.Status == AsyncOperationStatus.Succeeded) _locator = loading.Result;
            Addressables.Release(loading);
            if (_locator == null) throw unreachable ?? Unreadable(cause);
            _hash = hash;
            Storage.Flush(); // Addressables keeps catalogues, too
        }

        /// <summary>Only this collection: the app's own catalogues are its own affair.</summary>
        private async Task Update()
        {
            string hash;
            try
            {
                hash = await Hash();
            }
            catch (CaptureFault)
            {
                return; // the next look will tell, and what there is stays
            }
            if (hash == _hash) return;
            var updating = Addressables.UpdateCatalogs(new[] { _locator.LocatorId }, false);
            await Completion.Of(updating);
            var found = updating.Status == AsyncOperationStatus.Succeeded
                ? updating.Result.FirstOrDefault(each => each.LocatorId == _locator.LocatorId) : null;
            Addressables.Release(updating);
            if (found == null) return;
            _before = _locator;
            _locator = found;
            _hash = hash;
            Storage.Flush();
        }

        /// <summary>
        /// What changes with the catalogue. Asked for here, because Addressables tells a refusal from a lost connection as
        /// little as a missing collection from a damaged one.
        /// </summary>
        private async Task<string> Hash()
        {
            using (var memory = new MemoryStream())
            {
                await Catalogue.FetchAsync(Address(Path.ChangeExtension(Catalogue.FileName, ".hash")), memory);
                return Encoding.UTF8.GetString(memory.ToArray());
            }
        }

        private string Address(string file) => $"{BaseUrl}/collections/{Name}/unity/{file}";

        private CaptureFault Unreadable(Exception cause)
        {
            return new CaptureFault(CaptureFault.CatalogueUnreadable,
                $"the catalogue of collection {Name} is there, and Addressables cannot read it: {cause?.Message}",
                $"Is {Catalogue.FileName} the form that the installed Addressables reads?", cause);
        }

        private IReadOnlyList<string> AssetsAt(IEnumerable<string> keys)
        {
            var found = keys.SelectMany(each => AssetOf(_locator, each)).Select(AssetLocation.Key);
            return found.Distinct().OrderBy(each => each, StringComparer.Ordinal).ToList();
        }

        private static IEnumerable<IResourceLocation> AssetOf(IResourceLocator locator, string key)
        {
            return locator.Locate(key, typeof(GameObject), out var found) ? found : Enumerable.Empty<IResourceLocation>();
        }

        private static bool IsSame(IResourceLocation a, IResourceLocation b)
        {
            return a.InternalId == b.InternalId && Ids(a).SequenceEqual(Ids(b));
        }

        private static IEnumerable<string> Ids(IResourceLocation location)
        {
            return location.Dependencies == null ? Enumerable.Empty<string>() : location.Dependencies.Select(each => each.InternalId);
        }

        private static float Share(IReadOnlyList<Download> downloads)
        {
            var total = downloads.Sum(each => Math.Max(0, each.Size));
            var come = downloads.Sum(each => each.Task.IsCompleted ? Math.Max(0, each.Size) : each.Received);
            return total > 0 ? (float)come / total : 0;
        }
    }
}
