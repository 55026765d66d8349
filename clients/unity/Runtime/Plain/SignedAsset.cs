namespace Capture2vr
{
    /// <summary>An asset as the catalogue of one version has it.</summary>
    public sealed class SignedAsset
    {
        /// <summary>In place of a version: older than any.</summary>
        internal const long Doubted = -1;

        internal SignedAsset(FoundRow found, Manifest manifest)
        {
            Row = found.Row;
            Shard = found.Shard;
            CatalogueVersion = found.Version;
            Manifest = manifest;
        }

        public AssetRow Row { get; }
        public Manifest Manifest { get; }

        /// <summary>The hash of the shard that has its row.</summary>
        public string Shard { get; }

        public long CatalogueVersion { get; }

        /// <summary>The same as if it were of an older catalogue than any, and of no shard that is known.</summary>
        internal SignedAsset Doubt() => new SignedAsset(new FoundRow(Row.Key, Row, "", Doubted), Manifest);
    }
}
