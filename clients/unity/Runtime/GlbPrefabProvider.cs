using System;
using System.Collections.Generic;
using System.IO;
using System.Linq;
using System.Threading.Tasks;
using UnityEngine;
using UnityEngine.ResourceManagement.ResourceLocations;
using UnityEngine.ResourceManagement.ResourceProviders;
using UnityEngine.Scripting;

namespace Capture2vr
{
    /// <summary>
    /// Makes an asset of its files, which are the location's dependencies, finest first: one GameObject with a LODGroup,
    /// to be cloned. Where some files cannot be had the others must do. The catalogue names this class.
    /// </summary>
    [Preserve]
    public sealed class GlbPrefabProvider : ResourceProviderBase
    {
        private readonly Dictionary<GameObject, LodPrefab> _made = new Dictionary<GameObject, LodPrefab>();

        [Preserve]
        public GlbPrefabProvider()
        {
            m_BehaviourFlags = ProviderBehaviourFlags.CanProvideWithFailedDependencies;
        }

        public override async void Provide(ProvideHandle handle)
        {
            LodPrefab prefab = null;
            try
            {
                handle.SetWaitForCompletionCallback(Waiting.Refuse);
                var levels = Levels(handle);
                var version = AssetLocation.Version(handle.Location);
                await Check(handle.Location, version, levels);
                prefab = new LodPrefab(handle.Location.PrimaryKey, version);
                await Fill(prefab, levels);
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

        /// <summary>Paths by level of detail, of the files that are there.</summary>
        private static SortedDictionary<int, string> Levels(ProvideHandle handle)
        {
            var paths = new List<object>();
            handle.GetDependencies(paths);
            var locations = handle.Location.Dependencies;
            var levels = new SortedDictionary<int, string>();
            for (var place = 0; place < paths.Count; place++)
            {
                if (paths[place] is string path) levels[AssetLocation.Level(locations[place])] = path;
            }
            if (levels.Count > 0) return levels;
            throw new CaptureFault(CaptureFault.FileMissing, $"{handle.Location.PrimaryKey}: none of its files can be had",
                "The log tells why of each");
        }

        /// <summary>Signature before version: what nobody signed must not count as seen.</summary>
        private static async Task Check(IResourceLocation location, int version, SortedDictionary<int, string> levels)
        {
            // A file's name on the device is its hash.
            var files = levels.Values.Select(Path.GetFileName).ToList();
            var key = AssetLocation.Key(location);
            if (Catalogue.Trust != null) await Task.Run(() => Catalogue.Trust.Check(key, files));
            Catalogue.Versions.Check(location.PrimaryKey, version);
        }

        /// <summary>The coarsest first: it is the smallest, so what is wrong with an asset shows early.</summary>
        private static async Task Fill(LodPrefab prefab, SortedDictionary<int, string> levels)
        {
            foreach (var level in levels.Reverse()) await prefab.Add(level.Key, level.Value);
            prefab.Finish();
        }
    }
}
