using System;
using System.Collections.Generic;
using System.Linq;
using System.Threading.Tasks;
using UnityEngine;
using UnityEngine.ResourceManagement.ResourceLocations;
using UnityEngine.ResourceManagement.ResourceProviders;
using UnityEngine.Scripting;
using Object = UnityEngine.Object;

namespace Capture2vr
{
    /// <summary>
    /// Makes an asset of its files, which are the location's dependencies, finest first: one GameObject with a LODGroup,
    /// to be cloned. Where some files cannot be had the others must do. The catalogue names this class.
    /// </summary>
    [Preserve]
    public sealed class GlbPrefabProvider : ResourceProviderBase
    {
        private static GameObject _shelf;

        private readonly Dictionary<GameObject, LodRoot> _made = new Dictionary<GameObject, LodRoot>();

        [Preserve]
        public GlbPrefabProvider()
        {
            m_BehaviourFlags = ProviderBehaviourFlags.CanProvideWithFailedDependencies;
        }

        public override async void Provide(ProvideHandle handle)
        {
            LodRoot prefab = null;
            try
            {
                handle.SetWaitForCompletionCallback(Waiting.Refuse);
                var collection = Catalogue.Of(handle.Location);
                var location = await collection.CheckAsync(handle.Location);
                prefab = new LodRoot(location.PrimaryKey, AssetLocation.Version(location), Shelf());
                await Fill(prefab, collection.Files(location));
                _made[prefab.Root] = prefab;
                handle.Complete(prefab.Root, true, null);
            }
            catch (Exception fault)
            {
                prefab?.Dispose();
                handle.Complete<GameObject>(null, false, fault);
            }
        }

        public override void Release(IResourceLocation location, object asset)
        {
            if (!(asset is GameObject root) || !_made.TryGetValue(root, out var prefab)) return;
            _made.Remove(root);
            prefab.Dispose();
        }

        /// <summary>
        /// The coarsest first: it is the smallest, so what is wrong with an asset shows early. Out of the device's cache, not
        /// out of the dependencies: of those Addressables takes all away when one fails.
        /// </summary>
        private static async Task Fill(LodRoot prefab, IReadOnlyList<GlbFile> files)
        {
            CaptureFault missing = null;
            foreach (var file in files.Reverse())
            {
                try
                {
                    await prefab.AddAsync(file);
                }
                catch (CaptureFault fault) when (fault.Code != CaptureFault.MeshInvalid)
                {
                    missing = fault;
                }
            }
            if (prefab.Levels.Count > 0) return;
            throw new CaptureFault(CaptureFault.FileMissing, $"{prefab.Root.name}: none of its files can be had; the last: {missing?.Message}",
                "", missing);
        }

        /// <summary>Inactive, so that the prefabs on it are never drawn, while their clones, put elsewhere, are.</summary>
        private static Transform Shelf()
        {
            if (_shelf == null)
            {
                _shelf = new GameObject("capture2vr prefabs");
                _shelf.SetActive(false);
                Object.DontDestroyOnLoad(_shelf);
            }
            return _shelf.transform;
        }
    }
}
