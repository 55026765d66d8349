using System;
using UnityEngine.ResourceManagement.ResourceLocations;
using UnityEngine.ResourceManagement.ResourceProviders;

namespace Capture2vr
{
    /// <summary>A file as a location of the Addressables catalogue tells it.</summary>
    internal readonly struct GlbFile
    {
        public readonly string Url;
        public readonly string Sha256;
        public readonly long Size;

        /// <summary>Level of detail, 0 the finest.</summary>
        public readonly int Level;

        private GlbFile(string url, string sha256, long size, int level)
        {
            Url = url;
            Sha256 = sha256;
            Size = size;
            Level = level;
        }

        /// <summary>
        /// Unity's Hash128 has room for half a SHA-256 only; the whole one is in the file's name, and both must agree.
        /// Throws CaptureFault LOCATION_INVALID.
        /// </summary>
        /// <param name="collection">says which host has it</param>
        public static GlbFile Of(IResourceLocation location, OpenCollection collection)
        {
            var options = location.Data as AssetBundleRequestOptions;
            if (options == null) throw Invalid(location, "it has no size and no hash");
            var sha256 = Capture2vr.Sha256.InName(location.InternalId);
            if (sha256 == null) throw Invalid(location, "its name has no SHA-256");
            if (string.IsNullOrEmpty(options.Hash) || !sha256.StartsWith(options.Hash, StringComparison.Ordinal))
            {
                throw Invalid(location, "its name and its data have different hashes");
            }
            if (!location.InternalId.StartsWith(Catalogue.BaseUrl + "/", StringComparison.Ordinal))
            {
                throw Invalid(location, $"it does not begin with {Catalogue.BaseUrl}");
            }
            var url = collection.BaseUrl + location.InternalId.Substring(Catalogue.BaseUrl.Length);
            return new GlbFile(url, sha256, options.BundleSize, AssetLocation.Level(location));
        }

        private static CaptureFault Invalid(IResourceLocation location, string reason)
        {
            return new CaptureFault(CaptureFault.LocationInvalid, $"{location.PrimaryKey} ({location.InternalId}): {reason}",
                "Is this a catalogue of capture2vr?");
        }
    }
}
