using System;
using UnityEngine.ResourceManagement.AsyncOperations;
using UnityEngine.ResourceManagement.ResourceLocations;
using UnityEngine.ResourceManagement.ResourceProviders;
using UnityEngine.Scripting;

namespace Capture2vr
{
    /// <summary>
    /// Brings the .glb of a location onto the device and checks it; the result is a GlbFileResource. Network, hashing and storage
    /// are the business of other threads where there are any. The catalogue names this class.
    /// </summary>
    [Preserve]
    public sealed class GlbFileProvider : ResourceProviderBase
    {
        [Preserve]
        public GlbFileProvider()
        {
        }

        public override async void Provide(ProvideHandle handle)
        {
            try
            {
                var file = GlbFile.Of(handle.Location, Catalogue.Of(handle.Location));
                var download = Catalogue.Cache.Load(file.Url, file.Sha256, file.Size);
                handle.SetProgressCallback(() => Status(download).Percent);
                handle.SetDownloadProgressCallbacks(() => Status(download));
                handle.SetWaitForCompletionCallback(Waiting.Refuse);
                handle.Complete(new GlbFileResource(await download.Task, file.Sha256), true, null);
            }
            catch (Exception fault)
            {
                handle.Complete<GlbFileResource>(null, false, fault);
            }
        }

        public override void Release(IResourceLocation location, object asset)
        {
            if (asset is GlbFileResource file) Catalogue.Cache.Release(file.Sha256);
        }

        private static DownloadStatus Status(Download download)
        {
            return new DownloadStatus
            {
                TotalBytes = download.Size,
                DownloadedBytes = download.Received,
                IsDone = download.Task.IsCompleted,
            };
        }
    }

    internal static class Waiting
    {
        /// <summary>
        /// Answers WaitForCompletion, which would hold the thread that loading needs: the app would stand still for ever.
        /// </summary>
        public static bool Refuse()
        {
            throw new NotSupportedException("captures load in the background: use the handle's Completed, or await its Task where there is one");
        }
    }
}
