// Stand-in for com.unity.cloud.gltfast: reads no more of a .glb than its header and the bounds of its positions.
using System;
using System.Collections.Generic;
using System.Text;
using System.Threading;
using System.Threading.Tasks;
using UnityEngine;

namespace GLTFast.Logging
{
    public interface ICodeLogger
    {
        void Error(string message);
    }

    public class LogItem
    {
        private readonly string _text;

        public LogItem(string text)
        {
            _text = text;
        }

        public override string ToString() => _text;
    }

    public class CollectingLogger : ICodeLogger
    {
        private List<LogItem> _items;

        public int Count => _items == null ? 0 : _items.Count;

        /// <summary>Null as long as nothing was logged, as glTFast's is.</summary>
        public IEnumerable<LogItem> Items => _items;

        public void Error(string message) => (_items = _items ?? new List<LogItem>()).Add(new LogItem(message));
    }
}

namespace GLTFast
{
    using GLTFast.Logging;

    public interface IDownloadProvider
    {
    }

    public interface IDeferAgent
    {
    }

    public interface IMaterialGenerator
    {
    }

    public class ImportSettings
    {
        public bool GenerateMipMaps { get; set; }
        public int AnisotropicFilterLevel { get; set; } = 1;
    }

    public class GltfImport : IDisposable
    {
        /// <summary>Imports that nobody has disposed of.</summary>
        public static readonly List<GltfImport> Alive = new List<GltfImport>();

        /// <summary>What every import says and fails with, or null.</summary>
        public static string Fault;

        private readonly ICodeLogger _log;
        private object _document;
        private Mesh _mesh;

        public GltfImport(IDownloadProvider downloadProvider = null, IDeferAgent deferAgent = null,
            IMaterialGenerator materialGenerator = null, ICodeLogger logger = null)
        {
            UnityEngine.Object.OnMainThread();
            _log = logger;
            Alive.Add(this);
        }

        public async Task<bool> Load(byte[] data, Uri uri = null, ImportSettings importSettings = null,
            CancellationToken cancellationToken = default(CancellationToken))
        {
            await Task.Yield();
            if (Fault != null)
            {
                _log?.Error(Fault);
                return false;
            }
            if (data.Length < 20 || Encoding.ASCII.GetString(data, 0, 4) != "glTF") return false;
            _document = Capture2vr.Json.Parse(Encoding.UTF8.GetString(data, 20, BitConverter.ToInt32(data, 12)));
            _mesh = new Mesh { bounds = BoundsOf() };
            return true;
        }

        public async Task<bool> InstantiateMainSceneAsync(Transform parent, CancellationToken cancellationToken = default(CancellationToken))
        {
            await Task.Yield();
            var node = new GameObject("node");
            node.transform.SetParent(parent, false);
            Place(node.transform, (Dictionary<string, object>)Capture2vr.JsonSteps.List(Capture2vr.JsonSteps.In(_document, "nodes"))[0]);
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
