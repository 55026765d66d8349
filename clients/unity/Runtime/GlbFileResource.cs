using UnityEngine;
using UnityEngine.ResourceManagement.ResourceProviders;

namespace Capture2vr
{
    /// <summary>
    /// A .glb file on the device. In Addressables' eyes it is a bundle, since DownloadDependenciesAsync downloads nothing
    /// else; there is none in it.
    /// </summary>
    public sealed class GlbFileResource : IAssetBundleResource
    {
        internal GlbFileResource(string path, string sha256)
        {
            Path = path;
            Sha256 = sha256;
        }

        /// <summary>Where the file is, until the handle is released.</summary>
        public string Path { get; }

        public string Sha256 { get; }

        public AssetBundle GetAssetBundle() => null;
    }
}
