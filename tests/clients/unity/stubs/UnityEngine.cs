// Stand-ins for the engine: only what the package uses, with the signatures of Unity's scripting reference. They do just
// enough to follow what is made, destroyed and shown, and check that the engine is called from the main thread only.
using System;
using System.Collections.Generic;
using System.Linq;
using System.Reflection;
using System.Threading;

namespace UnityEngine
{
    public partial class Object
    {
        public static readonly List<Object> Alive = new List<Object>();
        public static Thread MainThread;

        private bool _destroyed;

        public string name { get; set; }

        protected Object()
        {
            OnMainThread();
            Alive.Add(this);
        }

        public static void OnMainThread()
        {
            if (MainThread != null && Thread.CurrentThread != MainThread) throw new InvalidOperationException("the engine, off its main thread");
        }

        public static void Destroy(Object obj)
        {
            OnMainThread();
            if (obj is GameObject root) root.Fell();
            else obj.Gone();
        }

        internal void Gone()
        {
            _destroyed = true;
            Alive.Remove(this);
        }

        public static void DontDestroyOnLoad(Object target) => OnMainThread();

        public static T Instantiate<T>(T original, Transform parent) where T : Object
        {
            var clone = ((GameObject)(object)original).Clone();
            clone.transform.SetParent(parent, false);
            return (T)(object)clone;
        }

        public static bool operator ==(Object x, Object y) => IsGone(x) ? IsGone(y) : ReferenceEquals(x, y);
        private static bool IsGone(Object x) => (object)x == null || x._destroyed;
        public static bool operator !=(Object x, Object y) => !(x == y);
        public override bool Equals(object other) => ReferenceEquals(this, other);
        public override int GetHashCode() => System.Runtime.CompilerServices.RuntimeHelpers.GetHashCode(this);
    }

    public class Component : Object
    {
        public GameObject gameObject { get; internal set; }
        public Transform transform => gameObject.transform;
        public T GetComponent<T>() => gameObject.GetComponent<T>();
    }

    public class Behaviour : Component
    {
    }

    public partial class MonoBehaviour : Behaviour
    {
    }

    public sealed partial class GameObject : Object
    {
        public readonly List<Component> Components = new List<Component>();

        public Transform transform { get; }
        public bool activeSelf { get; private set; } = true;
        public bool activeInHierarchy => activeSelf && (transform.parent == null || transform.parent.gameObject.activeInHierarchy);

        public GameObject(string name)
        {
            this.name = name;
            transform = AddComponent<Transform>();
        }

        public void SetActive(bool value) => activeSelf = value;

        public static GameObject CreatePrimitive(PrimitiveType type)
        {
            var made = new GameObject(type.ToString());
            made.AddComponent<MeshRenderer>();
            made.AddComponent<MeshCollider>();
            return made;
        }

        public T AddComponent<T>() where T : Component
        {
            var made = Activator.CreateInstance<T>();
            made.gameObject = this;
            Components.Add(made);
            return made;
        }

        public T GetComponent<T>() => Components.OfType<T>().FirstOrDefault();

        public T[] GetComponentsInChildren<T>(bool includeInactive)
        {
            var below = transform.Children.SelectMany(each => each.gameObject.GetComponentsInChildren<T>(includeInactive));
            return Components.OfType<T>().Concat(below).ToArray();
        }

        internal void Fell()
        {
            foreach (var child in transform.Children.ToList()) child.gameObject.Fell();
            transform.SetParent(null, false);
            foreach (var each in Components) each.Gone();
            Gone();
        }

        /// <summary>Copies what Unity serializes: here, public and [SerializeField] fields.</summary>
        internal GameObject Clone()
        {
            var clone = new GameObject(name + "(Clone)");
            foreach (var each in Components.Where(each => !(each is Transform)))
            {
                var copy = typeof(GameObject).GetMethod("AddComponent").MakeGenericMethod(each.GetType()).Invoke(clone, null);
                var fields = each.GetType().GetFields(BindingFlags.Instance | BindingFlags.Public | BindingFlags.NonPublic);
                foreach (var field in fields.Where(field => field.IsDefined(typeof(SerializeField), false)))
                {
                    field.SetValue(copy, field.GetValue(each));
                }
            }
            foreach (var child in transform.Children) child.gameObject.Clone().transform.SetParent(clone.transform, false);
            return clone;
        }
    }

    /// <summary>Without rotation in the hierarchy, which the tests do not need.</summary>
    public sealed class Transform : Component
    {
        internal readonly List<Transform> Children = new List<Transform>();

        public Transform parent { get; private set; }
        public Vector3 position { get; set; }
        public Vector3 localPosition { get; set; }
        public Quaternion rotation { get; set; }
        public Vector3 localScale { get; set; } = Vector3.one;
        public Vector3 forward { get; set; } = new Vector3(0, 0, 1);
        public int childCount => Children.Count;
        public Transform GetChild(int index) => Children[index];

        public void SetParent(Transform parent, bool worldPositionStays)
        {
            OnMainThread();
            if ((object)this.parent != null) this.parent.Children.Remove(this);
            this.parent = parent == null ? null : parent; // one that was destroyed is none: this then stands in the scene itself
            if ((object)this.parent != null) this.parent.Children.Add(this);
        }

        public Vector3 TransformPoint(Vector3 point)
        {
            var mine = new Vector3(point.x * localScale.x, point.y * localScale.y, point.z * localScale.z) + position;
            return (object)parent == null ? mine : parent.TransformPoint(mine);
        }

        public Vector3 InverseTransformPoint(Vector3 point)
        {
            var above = ((object)parent == null ? point : parent.InverseTransformPoint(point)) + position * -1;
            return new Vector3(above.x / localScale.x, above.y / localScale.y, above.z / localScale.z);
        }
    }

    public class Renderer : Component
    {
        private Material _material;

        /// <summary>A copy of its own, which whoever asks for it has to destroy.</summary>
        public Material material => _material = _material ?? new Material();
    }

    public sealed class Material : Object
    {
        public Texture mainTexture { get; set; }
        public Vector2 mainTextureScale { get; set; }
        public Vector2 mainTextureOffset { get; set; }
    }

    public class Texture : Object
    {
    }

    public sealed class Texture2D : Texture
    {
        public byte[] Loaded;

        public Texture2D(int width, int height)
        {
        }
    }

    public static class ImageConversion
    {
        public static bool LoadImage(this Texture2D tex, byte[] data, bool markNonReadable)
        {
            Object.OnMainThread();
            tex.Loaded = data;
            return true;
        }
    }

    public enum TextAnchor
    {
        UpperCenter = 1,
    }

    public sealed class TextMesh : Component
    {
        public string text { get; set; }
        public int fontSize { get; set; }
        public float characterSize { get; set; } = 1;
        public TextAnchor anchor { get; set; }
    }

    public enum PrimitiveType
    {
        Quad = 5,
    }

    public sealed class MeshCollider : Collider
    {
    }

    public sealed class MeshRenderer : Renderer
    {
    }

    public sealed class MeshFilter : Component
    {
        public Mesh sharedMesh { get; set; }
    }

    public sealed class Mesh : Object
    {
        public Bounds bounds { get; set; }
    }

    public sealed class Camera : Behaviour
    {
        public static Camera main { get; set; }
        public float fieldOfView { get; set; } = 90;
    }

    public class Collider : Component
    {
        public bool enabled { get; set; } = true;
    }

    public sealed class BoxCollider : Collider
    {
        public Vector3 center { get; set; }
        public Vector3 size { get; set; }
    }

    public sealed class Rigidbody : Component
    {
        public bool isKinematic { get; set; }
        public bool useGravity { get; set; } = true;
    }

    public sealed partial class AssetBundle : Object
    {
    }

    public static class QualitySettings
    {
        public static float lodBias { get; set; } = 1;
    }

    public enum LODFadeMode
    {
        None = 0,
        CrossFade = 1
    }

    public struct LOD
    {
        public float screenRelativeTransitionHeight;
        public float fadeTransitionWidth;
        public Renderer[] renderers;

        public LOD(float screenRelativeTransitionHeight, Renderer[] renderers)
        {
            this.screenRelativeTransitionHeight = screenRelativeTransitionHeight;
            this.renderers = renderers;
            fadeTransitionWidth = 0;
        }
    }

    public sealed class LODGroup : Component
    {
        private LOD[] _lods = new LOD[0];

        public Vector3 localReferencePoint { get; set; }
        public float size { get; set; }
        public LODFadeMode fadeMode { get; set; }
        public bool animateCrossFading { get; set; }
        public LOD[] GetLODs() => _lods;

        /// <summary>Unity logs an error for heights that do not fall; here it is one.</summary>
        public void SetLODs(LOD[] lods)
        {
            for (var place = 1; place < lods.Length; place++)
            {
                var falls = lods[place].screenRelativeTransitionHeight < lods[place - 1].screenRelativeTransitionHeight;
                if (!falls) throw new ArgumentException("LOD heights must fall");
            }
            _lods = lods;
        }
    }

    public struct Vector2
    {
        public float x, y;

        public Vector2(float x, float y)
        {
            this.x = x;
            this.y = y;
        }
    }

    public struct Vector3
    {
        public float x, y, z;

        public Vector3(float x, float y, float z)
        {
            this.x = x;
            this.y = y;
            this.z = z;
        }

        public static Vector3 zero => new Vector3();
        public static Vector3 one => new Vector3(1, 1, 1);
        public static Vector3 operator +(Vector3 a, Vector3 b) => new Vector3(a.x + b.x, a.y + b.y, a.z + b.z);
        public static float Distance(Vector3 a, Vector3 b)
        {
            var d = a + b * -1;
            return (float)Math.Sqrt(d.x * d.x + d.y * d.y + d.z * d.z);
        }

        public static Vector3 operator *(Vector3 a, float d) => new Vector3(a.x * d, a.y * d, a.z * d);
    }

    public partial struct Quaternion
    {
        public Vector3 eulerAngles { get; set; }
        public static Quaternion Euler(float x, float y, float z) => new Quaternion { eulerAngles = new Vector3(x, y, z) };
    }

    public struct Bounds
    {
        public Bounds(Vector3 center, Vector3 size)
        {
            min = new Vector3(center.x - size.x / 2, center.y - size.y / 2, center.z - size.z / 2);
            max = new Vector3(center.x + size.x / 2, center.y + size.y / 2, center.z + size.z / 2);
        }

        public Vector3 min { get; set; }
        public Vector3 max { get; set; }
        public Vector3 center => (min + max) * 0.5f;
        public Vector3 size => max + min * -1;

        public void Encapsulate(Vector3 point)
        {
            min = new Vector3(Math.Min(min.x, point.x), Math.Min(min.y, point.y), Math.Min(min.z, point.z));
            max = new Vector3(Math.Max(max.x, point.x), Math.Max(max.y, point.y), Math.Max(max.z, point.z));
        }
    }

    public partial struct Mathf
    {
        public const float Rad2Deg = 57.29578f;
        public const float Deg2Rad = 1 / Rad2Deg;
        public static float Tan(float f) => (float)Math.Tan(f);
        public static float Max(float a, float b) => Math.Max(a, b);
        public static float Min(float a, float b) => Math.Min(a, b);
        public static int Clamp(int value, int min, int max) => Math.Max(min, Math.Min(max, value));
    }

    public static partial class Application
    {
        public static string persistentDataPath { get; set; }
    }

    public static partial class Time
    {
        public static float unscaledTime { get; set; }
    }

    public static partial class Debug
    {
        public static readonly List<string> Errors = new List<string>();
        public static void Log(object message) => Console.WriteLine(message);
        public static void LogError(object message, Object context) => Errors.Add(message.ToString());
    }

    [AttributeUsage(AttributeTargets.Class)]
    public sealed class RequireComponent : Attribute
    {
        public RequireComponent(Type requiredComponent)
        {
        }
    }

    [AttributeUsage(AttributeTargets.Field)]
    public sealed class SerializeField : Attribute
    {
    }

    [AttributeUsage(AttributeTargets.Field)]
    public sealed class TooltipAttribute : Attribute
    {
        public TooltipAttribute(string tooltip)
        {
        }
    }

    public sealed class AddComponentMenu : Attribute
    {
        public AddComponentMenu(string menuName)
        {
        }
    }

    public enum RuntimeInitializeLoadType
    {
        BeforeSceneLoad = 1,
        SubsystemRegistration = 4
    }

    [AttributeUsage(AttributeTargets.Method)]
    public sealed class RuntimeInitializeOnLoadMethodAttribute : Attribute
    {
        public RuntimeInitializeOnLoadMethodAttribute(RuntimeInitializeLoadType loadType)
        {
        }
    }
}

namespace UnityEngine.Scripting
{
    public sealed class PreserveAttribute : Attribute
    {
    }

    [AttributeUsage(AttributeTargets.Assembly)]
    public sealed class AlwaysLinkAssemblyAttribute : Attribute
    {
    }
}
