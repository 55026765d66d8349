using System;
using System.Collections.Generic;
using System.Linq;
using System.Threading.Tasks;
using UnityEngine.AddressableAssets;
using UnityEngine.ResourceManagement.ResourceLocations;
using UnityEngine.ResourceManagement.ResourceProviders;

namespace Capture2vr
{
    /// <summary>
    /// Finds the assets of a collection, for Addressables too. Up to some thousand it has a catalogue that Addressables reads;
    /// what that does not have yet, and all of a larger collection, is looked up in the signed catalogue, asset by asset.
    /// </summary>
    internal sealed class AssetFinder
    {
        private const long Few = 5000; // assets: the server writes a catalogue for Addressables, if not at once

        private readonly string _name;
        private readonly UnityCatalogue _unity;
        private readonly SignedLocator _signed;
        private CollectionReader _reader;
        private long _count; // rows, where there is no catalogue for Addressables
        private long _version; // of the signed catalogue that was taken whole

        public AssetFinder(string name, UnityCatalogue unity, SignedLocator signed)
        {
            _name = name;
            _unity = unity;
            _signed = signed;
        }

        /// <summary>Reads the signed catalogue. What one before has read is not believed: the new one may ask for more signatures.</summary>
        public CollectionReader Reader
        {
            get => _reader;
            set
            {
                _reader = value;
                _signed.Doubt();
            }
        }

        public bool IsOpen { get; private set; }

        /// <summary>Whether all keys and labels are at hand.</summary>
        public bool IsListed => _unity.IsInUse || _signed.IsWhole;

        /// <summary>Keys of all assets, sorted. Throws CaptureFault COLLECTION_LARGE.</summary>
        public IReadOnlyList<string> Keys => At(_unity.Keys.Where(AssetLocation.IsAssets), row => true);

        /// <summary>Keys of the assets with a label, sorted. Throws CaptureFault COLLECTION_LARGE.</summary>
        public IReadOnlyList<string> WithLabel(string label) => At(new[] { label }, row => row.Labels.Contains(label));

        public async Task OpenAsync()
        {
            await Start();
            Provide(new GlbFileProvider());
            Provide(new GlbPrefabProvider());
            Addressables.AddResourceLocator(_signed); // first: what it has is not older than what Addressables reads itself
            try
            {
                await Take();
                IsOpen = true;
            }
            finally
            {
                if (!IsOpen) Addressables.RemoveResourceLocator(_signed);
            }
        }

        /// <summary>Take what is newer. What cannot be had stays as it is until the next look.</summary>
        public async Task UpdateAsync()
        {
            try
            {
                if (_unity.IsInUse || _count <= Few) await Take();
                await UpdateSigned();
            }
            catch (CaptureFault)
            {
                // The next look will tell, and what there is stays.
            }
        }

        /// <summary>Know where assets are; those that are known already are not asked for again. Throws CaptureFault.</summary>
        public async Task EnsureAsync(IEnumerable<string> keys)
        {
            var missing = keys.Where(each => Known(each) == null).ToList();
            while (missing.Count > 0)
            {
                var reader = _reader;
                var assets = await Background.Run(() => reader.Assets(missing));
                if (reader != _reader) continue;
                foreach (var each in assets) _signed.Put(each);
                return;
            }
        }

        /// <summary>Where an asset is that is known. Throws CaptureFault ASSET_UNKNOWN.</summary>
        public IResourceLocation Located(string key) => Known(key) ?? throw Unknown(key);

        public bool Has(IResourceLocation location) => _signed.Has(location) || _unity.Has(location);

        /// <summary>
        /// What the signed catalogue has for a location: the same, or a newer version. Without keys, the same. Throws CaptureFault.
        /// </summary>
        /// <param name="hashes">of the asset's files</param>
        public async Task<IResourceLocation> SignedAsync(IResourceLocation asset, IReadOnlyList<string> hashes)
        {
            var key = AssetLocation.Key(asset);
            var version = AssetLocation.Version(asset);
            while (!_signed.IsSigned(asset)) // else it was made of what the signed catalogue says
            {
                var reader = _reader;
                var newer = await Background.Run(() => reader.Check(key, version, hashes));
                if (reader != _reader) continue;
                if (newer == null) return asset;
                _signed.Put(newer);
                return _signed.Of(key) ?? throw Unknown(key);
            }
            return asset;
        }

        /// <summary>
        /// Start Addressables, which from 4.0 on has no reader of catalogues before. Whether the app has catalogues of its own to
        /// find then is not our affair. Nor is the handle: where the app has started it, it is the app's own, or one that goes
        /// with the event that we are called from.
        /// </summary>
        private static async Task Start()
        {
            try
            {
                var starting = Addressables.InitializeAsync();
                if (!starting.IsDone) await Completion.Of(starting);
            }
            catch (ArgumentOutOfRangeException)
            {
                // It answers with its first locator where it has tried before, and has none where it was built without settings.
            }
        }

        /// <summary>Addressables makes the providers that its own catalogues name; our locations are in none.</summary>
        private static void Provide(IResourceProvider provider)
        {
            var known = Addressables.ResourceManager.ResourceProviders;
            if (known.All(each => each.ProviderId != provider.ProviderId)) known.Add(provider);
        }

        /// <summary>The catalogue for Addressables, or where there is none, what takes its place.</summary>
        private async Task Take()
        {
            try
            {
                await _unity.TakeAsync();
            }
            catch (CaptureFault fault) when (fault.Code == CaptureFault.FileMissing || (IsShut(fault.Code) && !_unity.IsInUse))
            {
                await TakeSigned(fault.Code == CaptureFault.FileMissing);
                return;
            }
            _signed.IsWhole = false;
            var older = _signed.Assets.Select(each => each.Row).Where(each => VersionInUnity(each.Key) >= each.Version).ToList();
            foreach (var each in older) _signed.Remove(each.Key);
        }

        /// <summary>Without a network, or in a bucket that nobody may list, which says refused for missing.</summary>
        private static bool IsShut(string code) => code == CaptureFault.Unreachable || code == CaptureFault.AccessRefused;

        /// <summary>
        /// Of a large collection nothing but that it is there. Few assets are taken all, since the catalogue for Addressables is
        /// yet to be written.
        /// </summary>
        private async Task TakeSigned(bool isMissing)
        {
            var reader = _reader;
            var root = await Background.Run(reader.Root);
            _count = root.Count;
            if (isMissing) _unity.Abandon();
            if (_signed.IsWhole && _version == root.Version) return;
            _signed.IsWhole = false;
            if (_count > Few) return;
            try
            {
                var rows = await Background.Run(reader.Rows);
                await EnsureAsync(rows.Select(each => each.Key));
                _signed.IsWhole = reader == _reader;
                _version = root.Version;
            }
            catch (CaptureFault)
            {
                // Those that can be had are found one by one.
            }
        }

        private async Task UpdateSigned()
        {
            var reader = _reader;
            var known = _signed.Assets.ToList();
            if (known.Count == 0) return;
            var changes = await Background.Run(() => reader.Changes(known));
            if (reader != _reader) return;
            foreach (var each in changes)
            {
                if (each.Value == null) _signed.Remove(each.Key);
                else _signed.Put(each.Value);
            }
        }

        private IReadOnlyList<string> At(IEnumerable<string> keys, Func<AssetRow, bool> wanted)
        {
            if (!IsListed)
            {
                throw new CaptureFault(CaptureFault.CollectionLarge, $"collection {_name} has {_count:N0} assets, whose keys are not all at hand",
                    "Await KeysAsync or WithLabelAsync, which read them");
            }
            var signed = _signed.Assets.Select(each => each.Row).Where(wanted).Select(each => each.Key);
            var found = keys.SelectMany(_unity.AssetsAt).Select(AssetLocation.Key).Concat(signed);
            return found.Distinct().OrderBy(each => each, StringComparer.Ordinal).ToList();
        }

        /// <summary>The newer one of both catalogues, or null.</summary>
        private IResourceLocation Known(string key)
        {
            var signed = _signed.Of(key);
            return signed != null && AssetLocation.Version(signed) >= VersionInUnity(key) ? signed : InUnity(key);
        }

        private IResourceLocation InUnity(string key) => _unity.AssetsAt(AssetLocation.Prefix + key).FirstOrDefault();

        private int VersionInUnity(string key)
        {
            var location = InUnity(key);
            return location == null ? 0 : AssetLocation.Version(location);
        }

        private CaptureFault Unknown(string key)
        {
            return new CaptureFault(CaptureFault.AssetUnknown, $"collection {_name} has no asset {key}", IsListed ? "" : "Await EnsureAsync first");
        }
    }
}
