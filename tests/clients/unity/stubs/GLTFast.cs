// Stand-in for com.unity.cloud.gltfast: reads no more of a .glb than its header and the bounds of its positions.
using System;
using System.Collections.Generic;
using System.Text;
using System.Threading;
using System.Threading.Tasks;
using UnityEngine;

namespace GLTFast
{
    public class ImportSettings
    {
        public bool GenerateMipMaps { get; set; }
    }

    public class GltfImport : IDisposable
    {
        /// <summary>Imports that nobody has disposed of.</summary>
        public static readonly List<GltfImport> Alive = new List<GltfImport>();

        private object _document;
        private Mesh _mesh;

        public GltfImport()
        {
            UnityEngine.Object.OnMainThread();
            Alive.Add(this);
        }

        public async Task<bool> Load(byte[] data, Uri uri = null, ImportSettings importSettings = null,
            CancellationToken cancellationToken = default(CancellationToken))
        {
            await Task.Yield();
            if (data.Length < 20 || Encoding.ASCII.GetString(data, 0, 4) != "glTF") return false;
            _document = Capture2vr.Json.Parse(Encoding.UTF8.GetString(data, 20, BitConverter.ToInt32(data, 12)));
            return true;
        }

        public async Task<bool> InstantiateMainSceneAsync(Transform parent, CancellationToken cancellationToken = default(CancellationToken))
        {
            await Task.Yield();
            var node = new GameObject("node");
            node.transform.SetParent(parent, false);
            Place(node.transform, (Dictionary<string, object>)Capture2vr.JsonSteps.List(Capture2vr.JsonSteps.In(_document, "nodes"))[0]);
            _mesh = new Mesh { bounds = BoundsOf() };
            node.AddComponent<MeshFilter>().sharedMesh = _mesh;
            node.AddComponent<MeshRenderer>();
            return true;
        }

        public void Dispose()
        {
            Alive.Remove(this);
            if (_mesh != null) UnityEngine.Object.Destroy(_mesh);
        }

        private static void Place(Transform transform, Dictionary<string, object> node)
        {
            if (node.TryGetValue("translation", out var moved)) transform.position = Vector(moved);
            if (node.TryGetValue("scale", out var scaled)) transform.localScale = Vector(scaled);
        }

        private Bounds BoundsOf()
        {
            foreach (Dictionary<string, object> accessor in Capture2vr.JsonSteps.List(Capture2vr.JsonSteps.In(_document, "accessors")))
            {
                if (accessor.ContainsKey("min")) return new Bounds { min = Vector(accessor["min"]), max = Vector(accessor["max"]) };
            }
            throw new FormatException("no accessor has bounds");
        }

        private static Vector3 Vector(object told)
        {
            var numbers = Capture2vr.JsonSteps.List(told);
            return new Vector3(Convert.ToSingle(numbers[0]), Convert.ToSingle(numbers[1]), Convert.ToSingle(numbers[2]));
        }
    }
}
