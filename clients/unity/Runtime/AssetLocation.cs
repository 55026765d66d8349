using System;
using System.Globalization;
using UnityEngine.ResourceManagement.ResourceLocations;

namespace Capture2vr
{
    /// <summary>What the locations of an asset and of its files say.</summary>
    internal static class AssetLocation
    {
        public const string Prefix = "captures/";
        private const string LodPrefix = "lod";

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

        private static CaptureFault Invalid(IResourceLocation location, string reason)
        {
            return new CaptureFault(CaptureFault.LocationInvalid, $"{location.PrimaryKey}: {reason}",
                "Is this a catalogue of capture2vr?");
        }
    }
}
