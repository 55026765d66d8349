using System;
using System.Globalization;
using System.Linq;
using UnityEngine;
using UnityEngine.ResourceManagement.ResourceLocations;
using UnityEngine.ResourceManagement.ResourceProviders;

namespace Capture2vr
{
    /// <summary>What the locations of an asset and of its files say, and how they are made where no catalogue of Addressables has them.</summary>
    internal static class AssetLocation
    {
        public const string Prefix = "captures/";
        private const string LodPrefix = "lod";
        private const int HashDigits = 32; // what Unity's Hash128 has room for

        /// <summary>The asset's key in its collection.</summary>
        public static string Key(IResourceLocation location) => location.PrimaryKey.Substring(Prefix.Length);

        /// <summary>Whether a key of the catalogue is an asset's or one of its files', and no label.</summary>
        public static bool IsAssets(string key) => key.StartsWith(Prefix, StringComparison.Ordinal);

        /// <summary>The asset's version, from data such as {"version":3}. Throws CaptureFault LOCATION_INVALID.</summary>
        public static int Version(IResourceLocation location)
        {
            try
            {
                return checked((int)Json.Parse(location.Data as string ?? "").In("version").Whole());
            }
            catch (Exception fault) when (fault is FormatException || fault is OverflowException)
            {
                throw Invalid(location, "it has no version");
            }
        }

        /// <summary>The level of detail of a file, from a key such as captures/shoe/lod2.</summary>
        public static int Level(IResourceLocation location)
        {
            var name = location.PrimaryKey.Substring(location.PrimaryKey.LastIndexOf('/') + 1);
            var digits = name.StartsWith(LodPrefix, StringComparison.Ordinal) ? name.Substring(LodPrefix.Length) : "";
            if (int.TryParse(digits, NumberStyles.None, CultureInfo.InvariantCulture, out var level)) return level;
            throw Invalid(location, "it is no level of detail");
        }

        /// <summary>The location of an asset, which depends on those of its files, as the server writes them into its catalogues.</summary>
        public static IResourceLocation Of(SignedAsset asset)
        {
            var key = Prefix + asset.Row.Key;
            var files = asset.Manifest.Lods.Select(lod => FileOf(key, lod)).ToArray();
            var version = asset.Row.Version.ToString(CultureInfo.InvariantCulture);
            // Addressables gives what it has loaded of the same id: so each version has an id of its own.
            return new ResourceLocationBase(key, $"{key}@{version}", typeof(GlbPrefabProvider).FullName, typeof(GameObject), files)
            {
                Data = $"{{\"version\":{version}}}"
            };
        }

        private static IResourceLocation FileOf(string asset, LodFile lod)
        {
            var name = LodPrefix + lod.Level.ToString(CultureInfo.InvariantCulture);
            var id = $"{Catalogue.BaseUrl}/{lod.ObjectName}";
            return new ResourceLocationBase($"{asset}/{name}", id, typeof(GlbFileProvider).FullName, typeof(IAssetBundleResource))
            {
                Data = new AssetBundleRequestOptions { Hash = lod.Sha256.Substring(0, HashDigits), BundleName = name, BundleSize = lod.Bytes }
            };
        }

        /// <summary>Whether two locations are of the same version of an asset, with the same files.</summary>
        public static bool IsSame(IResourceLocation a, IResourceLocation b) => a.InternalId == b.InternalId && Files(a) == Files(b);

        private static string Files(IResourceLocation asset)
        {
            return asset.Dependencies == null ? "" : string.Join(" ", asset.Dependencies.Select(each => each.InternalId));
        }

        private static CaptureFault Invalid(IResourceLocation location, string reason)
        {
            return new CaptureFault(CaptureFault.LocationInvalid, $"{location.PrimaryKey}: {reason}",
                "Is this a catalogue of capture2vr?");
        }
    }
}
