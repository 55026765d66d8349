using System;
using System.Collections.Generic;
using System.Linq;
using System.Threading.Tasks;
using UnityEngine;
using Object = UnityEngine.Object;

namespace Capture2vr
{
    /// <summary>The GameObject of an asset, whose levels of detail come and go, and what must be freed with it.</summary>
    internal sealed class LodRoot : IDisposable
    {
        private sealed class Level
        {
            public GameObject Root;
            public SharedLevel Shared;
        }

        private readonly SortedDictionary<int, Level> _levels = new SortedDictionary<int, Level>();
        private readonly LODGroup _group;
        private readonly CapturedInfo _info;
        private readonly int _version;
        private bool _disposed;

        public GameObject Root { get; }

        public LodRoot(string name, int version, Transform parent)
        {
            _version = version;
            Root = new GameObject(name);
            Root.transform.SetParent(parent, false);
            _group = Root.AddComponent<LODGroup>();
            // Levels blend where the shader has the variant for it (LOD_FADE_CROSSFADE), and switch where it has not.
            _group.fadeMode = LODFadeMode.CrossFade;
            _group.animateCrossFading = true;
            _info = Root.AddComponent<CapturedInfo>();
        }

        /// <summary>Levels that are there, finest first.</summary>
        public IReadOnlyList<int> Levels => _levels.Keys.ToList();

        /// <summary>
        /// Add a level, which is then part of the LODGroup. Throws CaptureFault; what was there stays. False where this was
        /// disposed of meanwhile.
        /// </summary>
        public async Task<bool> AddAsync(GlbFile file)
        {
            var level = new Level { Root = new GameObject("lod" + file.Level), Shared = SharedLevel.Take(file) };
            level.Root.SetActive(false); // not seen before it is in the group
            var kept = false;
            try
            {
                await level.Shared.InstantiateAsync(level.Root.transform);
                if (level.Root.GetComponentsInChildren<MeshFilter>(true).Length == 0)
                {
                    throw new CaptureFault(CaptureFault.MeshInvalid, $"{file.Url}: it has no mesh");
                }
                kept = !_disposed;
                if (!kept) return false;
                // Only now: below an object that is destroyed meanwhile, what comes late would be put into the scene itself.
                level.Root.transform.SetParent(Root.transform, false);
                level.Root.SetActive(true);
                _levels[file.Level] = level;
                Tell();
                return true;
            }
            finally
            {
                if (!kept) Free(level);
            }
        }

        /// <summary>Free a level.</summary>
        public void Remove(int number)
        {
            var level = _levels[number];
            _levels.Remove(number);
            Tell();
            Free(level);
        }

        public void Dispose()
        {
            _disposed = true;
            foreach (var level in _levels.Values) Free(level);
            _levels.Clear();
            Object.Destroy(Root);
        }

        /// <summary>Say what there is: to the LODGroup, and to whom asks for the size.</summary>
        private void Tell()
        {
            var box = Box();
            var transitions = LodChoice.Transitions(Levels);
            _group.SetLODs(_levels.Values.Select((level, place) => new LOD(transitions[place], RenderersOf(level.Root))).ToArray());
            _group.localReferencePoint = box.center;
            _group.size = Mathf.Max(box.size.x, Mathf.Max(box.size.y, box.size.z));
            _info.Tell(_version, box);
        }

        private static void Free(Level level)
        {
            Object.Destroy(level.Root);
            level.Shared.Release();
        }

        private static Renderer[] RenderersOf(GameObject level) => level.GetComponentsInChildren<Renderer>(true);

        /// <summary>
        /// The box of the finest level, in metres, about the origin of the asset. By the meshes: the engine does not keep
        /// the bounds of renderers that are not active.
        /// </summary>
        private Bounds Box()
        {
            var corners = _levels.First().Value.Root.GetComponentsInChildren<MeshFilter>(true).SelectMany(Corners).ToList();
            var box = new Bounds(corners[0], Vector3.zero);
            foreach (var corner in corners) box.Encapsulate(corner);
            return box;
        }

        private IEnumerable<Vector3> Corners(MeshFilter filter)
        {
            var bounds = filter.sharedMesh.bounds;
            for (var corner = 0; corner < 8; corner++)
            {
                var x = (corner & 1) == 0 ? bounds.min.x : bounds.max.x;
                var y = (corner & 2) == 0 ? bounds.min.y : bounds.max.y;
                var z = (corner & 4) == 0 ? bounds.min.z : bounds.max.z;
                yield return Root.transform.InverseTransformPoint(filter.transform.TransformPoint(new Vector3(x, y, z)));
            }
        }
    }
}
