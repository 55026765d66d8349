using System;
using System.Collections.Generic;
using System.IO;
using System.Linq;
using System.Threading.Tasks;
using GLTFast;
using UnityEngine;
using Object = UnityEngine.Object;

namespace Capture2vr
{
    /// <summary>
    /// The GameObject of an asset, level by level, and what must be freed with it: glTFast's imports own the meshes,
    /// materials and textures that all clones share.
    /// </summary>
    internal sealed class LodPrefab : IDisposable
    {
        private static GameObject _shelf;

        private readonly SortedDictionary<int, GameObject> _levels = new SortedDictionary<int, GameObject>();
        private readonly List<GltfImport> _imports = new List<GltfImport>();
        private readonly int _version;

        public GameObject Root { get; }

        public LodPrefab(string name, int version)
        {
            _version = version;
            Root = new GameObject(name);
            Root.transform.SetParent(Shelf(), false);
        }

        /// <summary>Read, decode and add a level. The file is read on another thread; glTFast spreads its work over frames.</summary>
        public async Task Add(int level, string path)
        {
            var data = await Task.Run(() => File.ReadAllBytes(path));
            var import = new GltfImport();
            _imports.Add(import);
            // Mips: without them the textures of distant assets glitter.
            if (!await import.Load(data, null, new ImportSettings { GenerateMipMaps = true })) throw Invalid(level);
            var parent = new GameObject("lod" + level);
            parent.transform.SetParent(Root.transform, false);
            _levels[level] = parent;
            if (!await import.InstantiateMainSceneAsync(parent.transform)) throw Invalid(level);
        }

        /// <summary>Make a LODGroup of the levels.</summary>
        public void Finish()
        {
            var box = Box();
            var group = Root.AddComponent<LODGroup>();
            var transitions = LodChoice.Transitions(_levels.Keys.ToList());
            group.SetLODs(_levels.Values.Select((level, place) => new LOD(transitions[place], RenderersOf(level))).ToArray());
            group.localReferencePoint = box.center;
            group.size = Mathf.Max(box.size.x, Mathf.Max(box.size.y, box.size.z));
            Root.AddComponent<CapturedInfo>().Tell(_version, box.size);
        }

        public void Dispose()
        {
            Object.Destroy(Root);
            foreach (var import in _imports) import.Dispose();
            _imports.Clear();
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

        private static Renderer[] RenderersOf(GameObject level) => level.GetComponentsInChildren<Renderer>(true);

        /// <summary>
        /// The box of the finest level, in metres, about the origin of the asset. By the meshes: the engine does not keep
        /// the bounds of renderers that are not active.
        /// </summary>
        private Bounds Box()
        {
            var corners = _levels.First().Value.GetComponentsInChildren<MeshFilter>(true).SelectMany(Corners).ToList();
            if (corners.Count == 0) throw Invalid(_levels.Keys.First());
            var box = new Bounds(corners[0], Vector3.zero);
            foreach (var corner in corners) box.Encapsulate(corner);
            return box;
        }

        private static IEnumerable<Vector3> Corners(MeshFilter filter)
        {
            var bounds = filter.sharedMesh.bounds;
            for (var corner = 0; corner < 8; corner++)
            {
                var x = (corner & 1) == 0 ? bounds.min.x : bounds.max.x;
                var y = (corner & 2) == 0 ? bounds.min.y : bounds.max.y;
                var z = (corner & 4) == 0 ? bounds.min.z : bounds.max.z;
                yield return filter.transform.TransformPoint(new Vector3(x, y, z));
            }
        }

        private CaptureFault Invalid(int level)
        {
            return new CaptureFault(CaptureFault.MeshInvalid, $"{Root.name}: no mesh can be made of its level {level}",
                "Is the package com.unity.meshopt.decompress installed?");
        }
    }
}
