using System;
using System.Collections.Generic;
using System.Linq;
using UnityEngine.AddressableAssets.ResourceLocators;
using UnityEngine.ResourceManagement.ResourceLocations;

namespace Capture2vr
{
    /// <summary>
    /// Tells Addressables where assets are that were read from the signed catalogue: those that were asked for, of a collection
    /// that may have any number. On the main thread only.
    /// </summary>
    internal sealed class SignedLocator : IResourceLocator
    {
        private readonly Dictionary<string, SignedAsset> _assets = new Dictionary<string, SignedAsset>();
        private readonly Dictionary<string, IResourceLocation> _locations = new Dictionary<string, IResourceLocation>(); // by their keys
        private readonly Dictionary<string, IResourceLocation> _before = new Dictionary<string, IResourceLocation>(); // who has one may still load it

        public SignedLocator(string id)
        {
            LocatorId = id;
        }

        public string LocatorId { get; }

        /// <summary>Whether it has all assets of the collection; only then labels are keys too.</summary>
        public bool IsWhole { get; set; }

        public IReadOnlyCollection<SignedAsset> Assets => _assets.Values;

        public IEnumerable<object> Keys => IsWhole ? _locations.Keys.Concat(_assets.Values.SelectMany(each => each.Row.Labels).Distinct()) : _locations.Keys;

        /// <summary>Addressables asks for it where it reads binary catalogues.</summary>
        public IEnumerable<IResourceLocation> AllLocations => _locations.Values;

        public bool Locate(object key, Type type, out IList<IResourceLocation> locations)
        {
            var found = At(key as string ?? "").Where(each => type == null || type.IsAssignableFrom(each.ResourceType)).ToList();
            locations = found.Count > 0 ? found : null;
            return found.Count > 0;
        }

        /// <summary>Where an asset is, or null.</summary>
        public IResourceLocation Of(string asset) => _locations.TryGetValue(AssetLocation.Prefix + asset, out var location) ? location : null;

        /// <summary>Whether a location is that which the signed catalogue gives for its key now.</summary>
        public bool IsSigned(IResourceLocation location)
        {
            return Has(_locations, location) && _assets[AssetLocation.Key(location)].CatalogueVersion > SignedAsset.Doubted;
        }

        /// <summary>Whether it is that, or was it before the last change.</summary>
        public bool Has(IResourceLocation location) => Has(_locations, location) || Has(_before, location);

        /// <summary>Take an asset, instead of an earlier version of it. One that no level of detail is known of cannot be loaded.</summary>
        public void Put(SignedAsset asset)
        {
            var known = _assets.TryGetValue(asset.Row.Key, out var old);
            if (known && old.CatalogueVersion > asset.CatalogueVersion) return; // read earlier, and come later
            if (!known || old.Row.Version != asset.Row.Version || old.Row.ManifestSha256 != asset.Row.ManifestSha256)
            {
                Remove(asset.Row.Key);
                if (asset.Manifest.Lods.Count == 0) return;
                var location = AssetLocation.Of(asset);
                foreach (var each in location.Dependencies.Concat(new[] { location })) _locations[each.PrimaryKey] = each;
            }
            _assets[asset.Row.Key] = asset;
        }

        /// <summary>Let go of an asset. Whoever has its location may still load it.</summary>
        public void Remove(string asset)
        {
            var location = Of(asset);
            _assets.Remove(asset);
            if (location == null) return;
            foreach (var each in location.Dependencies.Concat(new[] { location }))
            {
                _locations.Remove(each.PrimaryKey);
                _before[each.PrimaryKey] = each;
            }
        }

        /// <summary>Have all looked up anew before they are shown: more signatures are asked for than when they were read.</summary>
        public void Doubt()
        {
            foreach (var each in _assets.Values.ToList()) _assets[each.Row.Key] = each.Doubt();
        }

        private IEnumerable<IResourceLocation> At(string key)
        {
            if (_locations.TryGetValue(key, out var location)) return new[] { location };
            if (!IsWhole) return new IResourceLocation[0];
            return _assets.Values.Where(each => each.Row.Labels.Contains(key)).Select(each => Of(each.Row.Key));
        }

        private static bool Has(Dictionary<string, IResourceLocation> locations, IResourceLocation location)
        {
            return locations.TryGetValue(location.PrimaryKey, out var found) && AssetLocation.IsSame(found, location);
        }
    }
}
