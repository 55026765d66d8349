using System;

namespace Capture2vr
{
    /// <summary>Why something cannot be shown: a code for programs, a sentence and a hint for people.</summary>
    public sealed class CaptureFault : Exception
    {
        /// <summary>The file has other bytes than its catalogue says: damaged on the way, or tampered with.</summary>
        public const string FileChanged = "FILE_CHANGED";
        /// <summary>The server has no such file.</summary>
        public const string FileMissing = "FILE_MISSING";
        /// <summary>No answer, or one that is no success. Worth another try.</summary>
        public const string Unreachable = "UNREACHABLE";
        /// <summary>The server wants to know who asks, and does not let this one in: Catalogue.AccessTo.</summary>
        public const string AccessRefused = "ACCESS_REFUSED";
        /// <summary>The device cannot keep the file: its storage is full or closed.</summary>
        public const string StorageFailed = "STORAGE_FAILED";
        /// <summary>A location of the Addressables catalogue that this package did not expect.</summary>
        public const string LocationInvalid = "LOCATION_INVALID";
        /// <summary>The file is whole, and no mesh can be made of it.</summary>
        public const string MeshInvalid = "MESH_INVALID";
        /// <summary>A catalogue that is cut off, or that no catalogue can be read from.</summary>
        public const string CatalogueTruncated = "CATALOGUE_TRUNCATED";
        /// <summary>Addressables' catalogue is there, and Addressables cannot read it.</summary>
        public const string CatalogueUnreadable = "CATALOGUE_UNREADABLE";
        /// <summary>The catalogue of another collection.</summary>
        public const string CatalogueOther = "CATALOGUE_OTHER";
        /// <summary>An older version than this device has seen.</summary>
        public const string CatalogueOlder = "CATALOGUE_OLDER";
        /// <summary>Nobody signed the catalogue, and this app asks for a signature.</summary>
        public const string SignatureMissing = "SIGNATURE_MISSING";
        /// <summary>The signature belongs to another text.</summary>
        public const string SignatureWrong = "SIGNATURE_WRONG";
        /// <summary>Signed, but by none of the keys that this app believes.</summary>
        public const string KeyUnknown = "KEY_UNKNOWN";
        /// <summary>The collection was not opened, or could not be.</summary>
        public const string CollectionClosed = "COLLECTION_CLOSED";
        /// <summary>A list of all keys is asked for at once, and the collection has too many: KeysAsync, WithLabelAsync.</summary>
        public const string CollectionLarge = "COLLECTION_LARGE";
        /// <summary>The signed catalogue does not have the asset.</summary>
        public const string AssetUnknown = "ASSET_UNKNOWN";
        /// <summary>The asset was taken out of sight.</summary>
        public const string AssetRemoved = "ASSET_REMOVED";
        /// <summary>A file or a version that the signed catalogue does not list for the asset.</summary>
        public const string FileNotSigned = "FILE_NOT_SIGNED";

        public string Code { get; }

        /// <summary>What to do about it, or "".</summary>
        public string Hint { get; }

        public CaptureFault(string code, string message, string hint = "", Exception cause = null)
            : base(hint == "" ? message : message + ". " + hint, cause)
        {
            Code = code;
            Hint = hint;
        }
    }
}
