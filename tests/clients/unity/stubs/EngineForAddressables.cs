// Stand-ins for those parts of the engine that Unity's own Addressables is compiled with, and our package is not. Addressables
// itself needs few of them to find assets: frames, logs, files, JSON, hashes. What belongs to bundles, scenes and sprites is there
// by name only, and says so when it is called.
using System;
using System.Collections;
using System.Collections.Generic;
using System.Globalization;
using System.IO;
using System.Linq;
using System.Reflection;
using System.Security.Cryptography;
using System.Text;
using System.Threading;

namespace UnityEngine
{
    public static class NoStandIn
    {
        public static Exception For(string what) => new NotSupportedException($"the stand-ins for the engine have no {what}");
    }

    /// <summary>The engine's frames: every component is told of each, by the methods that it has for that.</summary>
    public static class PlayerLoop
    {
        private static readonly Dictionary<Type, MethodInfo[]> Methods = new Dictionary<Type, MethodInfo[]>();
        private static readonly object[] None = new object[0];

        public static void Frame(float seconds)
        {
            Time.unscaledDeltaTime = seconds;
            Time.unscaledTime += seconds;
            Time.frameCount++;
            var all = Object.Alive.OfType<MonoBehaviour>().ToArray();
            for (var which = 0; which < 2; which++)
            {
                foreach (var each in all) Of(each.GetType())[which]?.Invoke(each, None);
            }
        }

        private static MethodInfo[] Of(Type type)
        {
            if (Methods.TryGetValue(type, out var known)) return known;
            const BindingFlags flags = BindingFlags.Instance | BindingFlags.Public | BindingFlags.NonPublic;
            return Methods[type] = new[] { "Update", "LateUpdate" }.Select(each => type.GetMethod(each, flags, null, Type.EmptyTypes, null)).ToArray();
        }
    }

    [Flags]
    public enum HideFlags
    {
        None = 0,
        DontSave = 52,
        HideAndDontSave = 61
    }

    public partial class Object
    {
        public HideFlags hideFlags { get; set; }

        public int GetInstanceID() => GetHashCode();
        public static implicit operator bool(Object exists) => exists != null;
        public static void DestroyImmediate(Object obj) => Destroy(obj);
        public static T FindObjectOfType<T>() where T : Object => Alive.OfType<T>().FirstOrDefault();
        public static T FindFirstObjectByType<T>() where T : Object => FindObjectOfType<T>();
        public static T FindAnyObjectByType<T>() where T : Object => FindObjectOfType<T>();
        public static T Instantiate<T>(T original) where T : Object => Instantiate(original, null);
        public static T Instantiate<T>(T original, Transform parent, bool instantiateInWorldSpace) where T : Object => Instantiate(original, parent);
        public static T Instantiate<T>(T original, Vector3 position, Quaternion rotation) where T : Object => Instantiate(original, position, rotation, null);

        public static T Instantiate<T>(T original, Vector3 position, Quaternion rotation, Transform parent) where T : Object
        {
            var made = Instantiate(original, parent);
            var place = ((GameObject)(object)made).transform;
            place.position = position;
            place.rotation = rotation;
            return made;
        }
    }

    public partial class MonoBehaviour
    {
        public CancellationToken destroyCancellationToken => CancellationToken.None;
    }

    public sealed partial class GameObject
    {
        public GameObject() : this("New Game Object")
        {
        }

        public GameObject(string name, params Type[] components) : this(name)
        {
            foreach (var each in components) typeof(GameObject).GetMethod("AddComponent").MakeGenericMethod(each).Invoke(this, null);
        }

        public SceneManagement.Scene scene => new SceneManagement.Scene();
    }

    public partial struct Quaternion
    {
        public static Quaternion identity => new Quaternion();
    }

    public partial struct Mathf
    {
        public static bool Approximately(float a, float b) => Math.Abs(b - a) < 1e-6f * Math.Max(Math.Abs(a), Math.Abs(b)) + 1e-37f;
        public static int Min(int a, int b) => Math.Min(a, b);
        public static int Max(int a, int b) => Math.Max(a, b);
        public static float Clamp01(float value) => Math.Max(0, Math.Min(1, value));
    }

    public class YieldInstruction
    {
    }

    public class CustomYieldInstruction : IEnumerator
    {
        public virtual bool keepWaiting => false;
        public object Current => null;
        public bool MoveNext() => keepWaiting;

        public void Reset()
        {
        }
    }

    public class AsyncOperation : YieldInstruction
    {
        public event Action<AsyncOperation> completed;

        public bool isDone { get; private set; }
        public float progress => isDone ? 1 : 0;
        public int priority { get; set; }
        public bool allowSceneActivation { get; set; }

        internal void Finish()
        {
            isDone = true;
            completed?.Invoke(this);
        }
    }

    public class ResourceRequest : AsyncOperation
    {
        public Object asset => throw NoStandIn.For("resources");
    }

    public class AssetBundleCreateRequest : AsyncOperation
    {
        public AssetBundle assetBundle => throw NoStandIn.For("bundles");
    }

    public class AssetBundleRequest : ResourceRequest
    {
        public Object[] allAssets => throw NoStandIn.For("bundles");
    }

    public class AssetBundleUnloadOperation : AsyncOperation
    {
        public void WaitForCompletion() => throw NoStandIn.For("bundles");
    }

    public sealed partial class AssetBundle
    {
        public static AssetBundleCreateRequest LoadFromFileAsync(string path, uint crc = 0, ulong offset = 0) => throw NoStandIn.For("bundles");
        public static AssetBundle LoadFromFile(string path, uint crc = 0, ulong offset = 0) => throw NoStandIn.For("bundles");
        public static IEnumerable<AssetBundle> GetAllLoadedAssetBundles() => new AssetBundle[0];
        public AssetBundleRequest LoadAllAssetsAsync<T>() => throw NoStandIn.For("bundles");
        public AssetBundleRequest LoadAllAssetsAsync() => throw NoStandIn.For("bundles");
        public AssetBundleRequest LoadAssetAsync(string name, Type type) => throw NoStandIn.For("bundles");
        public AssetBundleRequest LoadAssetWithSubAssetsAsync(string name, Type type) => throw NoStandIn.For("bundles");
        public T[] LoadAllAssets<T>() => throw NoStandIn.For("bundles");
        public Object LoadAsset(string name, Type type) => throw NoStandIn.For("bundles");
        public Object[] LoadAssetWithSubAssets(string name, Type type) => throw NoStandIn.For("bundles");
        public AssetBundleUnloadOperation UnloadAsync(bool unloadAllLoadedObjects) => throw NoStandIn.For("bundles");
        public void Unload(bool unloadAllLoadedObjects) => throw NoStandIn.For("bundles");
    }

    public static class Resources
    {
        public static ResourceRequest LoadAsync(string path, Type systemTypeInstance) => throw NoStandIn.For("resources");
        public static Object Load(string path, Type systemTypeInstance) => throw NoStandIn.For("resources");
        public static Object[] LoadAll(string path, Type systemTypeInstance) => throw NoStandIn.For("resources");
        public static void UnloadAsset(Object assetToUnload) => throw NoStandIn.For("resources");
    }

    public class Sprite : Object
    {
    }

    public class Texture3D : Texture
    {
    }

    public class TextAsset : Object
    {
        public string text => throw NoStandIn.For("resources");
        public byte[] bytes => throw NoStandIn.For("resources");
    }

    public class ScriptableObject : Object
    {
    }

    public class PropertyAttribute : Attribute
    {
    }

    public sealed class ExecuteInEditMode : Attribute
    {
    }

    public sealed class ExecuteAlways : Attribute
    {
    }

    public enum LogType
    {
        Error,
        Assert,
        Warning,
        Log,
        Exception
    }

    public static partial class Debug
    {
        public static void LogError(object message) => Errors.Add(message.ToString());
        public static void LogErrorFormat(string format, params object[] args) => LogError(Text(format, args));
        public static void LogException(Exception exception) => LogError(exception);
        public static void LogWarning(object message) => Console.Error.WriteLine(message);
        public static void LogWarningFormat(string format, params object[] args) => LogWarning(Text(format, args));
        public static void LogFormat(string format, params object[] args) => Log(Text(format, args));

        public static void Assert(bool condition, string message = "Assertion failed")
        {
            if (!condition) throw new InvalidOperationException(message);
        }

        private static string Text(string format, object[] args) => args.Length == 0 ? format : string.Format(format, args);
    }

    /// <summary>As Unity's manual numbers them.</summary>
    public enum RuntimePlatform
    {
        OSXEditor = 0,
        OSXPlayer = 1,
        WindowsPlayer = 2,
        WindowsEditor = 7,
        IPhonePlayer = 8,
        Android = 11,
        LinuxPlayer = 13,
        LinuxEditor = 16,
        WebGLPlayer = 17,
        WSAPlayerX86 = 18,
        WSAPlayerX64 = 19,
        WSAPlayerARM = 20,
        PS4 = 25,
        XboxOne = 27,
        Switch = 32,
        VisionOS = 50
    }

    public static partial class Application
    {
        public static string streamingAssetsPath { get; set; }
        public static string temporaryCachePath => persistentDataPath;
        public static string dataPath => persistentDataPath;
        public static bool isPlaying => true;
        public static RuntimePlatform platform => RuntimePlatform.LinuxPlayer;
    }

    public static partial class Time
    {
        public static float unscaledDeltaTime { get; internal set; }
        public static float realtimeSinceStartup => unscaledTime;
        public static int frameCount { get; internal set; }
    }

    /// <summary>16 bytes, which a text has in their order as hexadecimal digits.</summary>
    public struct Hash128 : IEquatable<Hash128>
    {
        private const int Bytes = 16;
        private readonly ulong _first, _last; // as they are in memory, where binary catalogues are copied to

        public Hash128(ulong first, ulong last)
        {
            _first = first;
            _last = last;
        }

        public bool isValid => _first != 0 || _last != 0;

        public static Hash128 Parse(string hashString)
        {
            var bytes = new byte[Bytes];
            for (var place = 0; place < Bytes; place++)
            {
                var digits = hashString != null && hashString.Length == 2 * Bytes ? hashString.Substring(2 * place, 2) : "";
                if (!byte.TryParse(digits, NumberStyles.AllowHexSpecifier, CultureInfo.InvariantCulture, out bytes[place])) return new Hash128();
            }
            return Of(bytes);
        }

        public static Hash128 Compute(string data)
        {
            using (var hash = MD5.Create()) return Of(hash.ComputeHash(Encoding.UTF8.GetBytes(data)));
        }

        public override string ToString()
        {
            return string.Concat(BitConverter.GetBytes(_first).Concat(BitConverter.GetBytes(_last)).Select(each => each.ToString("x2")));
        }

        public static bool operator ==(Hash128 hash1, Hash128 hash2) => hash1.Equals(hash2);
        public static bool operator !=(Hash128 hash1, Hash128 hash2) => !hash1.Equals(hash2);
        public bool Equals(Hash128 other) => _first == other._first && _last == other._last;
        public override bool Equals(object obj) => obj is Hash128 && Equals((Hash128)obj);
        public override int GetHashCode() => (_first ^ _last).GetHashCode();
        private static Hash128 Of(byte[] bytes) => new Hash128(BitConverter.ToUInt64(bytes, 0), BitConverter.ToUInt64(bytes, Bytes / 2));
    }

    public struct Cache
    {
        public string path { get; internal set; }
        public bool valid => path != null;
        public bool readOnly => false;
        public long maximumAvailableStorageSpace { get; set; }
        public int expirationDelay { get; set; }
    }

    public struct CachedAssetBundle
    {
        public CachedAssetBundle(string name, Hash128 hash)
        {
        }
    }

    /// <summary>Of bundles, of which there are none.</summary>
    public static class Caching
    {
        public static bool ready => true;
        public static bool compressionEnabled { get; set; }
        public static Cache defaultCache => new Cache { path = Path.Combine(Application.persistentDataPath, "bundles", "shared") };
        public static Cache currentCacheForWriting { get; set; } = new Cache { path = "" };
        public static Cache AddCache(string cachePath) => new Cache { path = cachePath };
        public static Cache GetCacheByPath(string cachePath) => new Cache();
        public static bool IsVersionCached(CachedAssetBundle cachedBundle) => false;
        public static bool ClearAllCachedVersions(string assetBundleName) => true;
        public static bool ClearCachedVersion(string assetBundleName, Hash128 hash) => true;
        public static bool ClearOtherCachedVersions(string assetBundleName, Hash128 hash) => true;
    }

    public sealed class Awaitable
    {
        public Awaiter GetAwaiter() => throw NoStandIn.For("awaitables");

        public struct Awaiter : System.Runtime.CompilerServices.INotifyCompletion
        {
            public bool IsCompleted => throw NoStandIn.For("awaitables");
            public void OnCompleted(Action continuation) => throw NoStandIn.For("awaitables");
            public void GetResult() => throw NoStandIn.For("awaitables");
        }
    }

    public sealed class Awaitable<T>
    {
        public Awaiter GetAwaiter() => throw NoStandIn.For("awaitables");

        public struct Awaiter : System.Runtime.CompilerServices.INotifyCompletion
        {
            public bool IsCompleted => throw NoStandIn.For("awaitables");
            public void OnCompleted(Action continuation) => throw NoStandIn.For("awaitables");
            public T GetResult() => throw NoStandIn.For("awaitables");
        }
    }

    public sealed class AwaitableCompletionSource
    {
        public Awaitable Awaitable => throw NoStandIn.For("awaitables");
        public void SetResult() => throw NoStandIn.For("awaitables");
        public void SetException(Exception exception) => throw NoStandIn.For("awaitables");
        public bool TrySetCanceled() => throw NoStandIn.For("awaitables");
    }

    public sealed class AwaitableCompletionSource<T>
    {
        public Awaitable<T> Awaitable => throw NoStandIn.For("awaitables");
        public void SetResult(T value) => throw NoStandIn.For("awaitables");
        public void SetException(Exception exception) => throw NoStandIn.For("awaitables");
        public bool TrySetCanceled() => throw NoStandIn.For("awaitables");
    }
}

namespace UnityEngine.U2D
{
    public class SpriteAtlas : Object
    {
        public Sprite GetSprite(string name) => throw NoStandIn.For("sprites");
    }
}

namespace UnityEngine.SceneManagement
{
    public enum LoadSceneMode
    {
        Single,
        Additive
    }

    public enum UnloadSceneOptions
    {
        None,
        UnloadAllEmbeddedSceneObjects
    }

    public struct LoadSceneParameters
    {
        public LoadSceneParameters(LoadSceneMode mode)
        {
            loadSceneMode = mode;
        }

        public LoadSceneMode loadSceneMode { get; set; }
    }

    public struct Scene
    {
        public string name => "";
        public string path => "";
        public bool isLoaded => true;
        public bool IsValid() => true;
        public static bool operator ==(Scene lhs, Scene rhs) => true;
        public static bool operator !=(Scene lhs, Scene rhs) => false;
        public override bool Equals(object other) => other is Scene;
        public override int GetHashCode() => 0;
    }

    public static class SceneManager
    {
        /// <summary>Never: there are no scenes to unload.</summary>
        public static event Action<Scene> sceneUnloaded
        {
            add { }
            remove { }
        }

        public static int sceneCount => 1;
        public static Scene GetSceneAt(int index) => new Scene();
        public static Scene GetActiveScene() => new Scene();
        public static AsyncOperation LoadSceneAsync(string sceneName, LoadSceneParameters parameters) => throw NoStandIn.For("scenes");
        public static AsyncOperation UnloadSceneAsync(Scene scene, UnloadSceneOptions options) => throw NoStandIn.For("scenes");
    }
}

namespace UnityEngine.Serialization
{
    [AttributeUsage(AttributeTargets.Field)]
    public sealed class FormerlySerializedAsAttribute : Attribute
    {
        public FormerlySerializedAsAttribute(string oldName)
        {
        }
    }
}

namespace UnityEngine.Profiling
{
    public static class Profiler
    {
        public static bool enabled => false;
        public static long GetMonoUsedSizeLong() => GC.GetTotalMemory(false);

        public static void EmitFrameMetaData(Guid id, int tag, Array data)
        {
        }

        public static void BeginSample(string name)
        {
        }

        public static void EndSample()
        {
        }
    }
}

namespace UnityEngine.Assertions
{
    public static class Assert
    {
        public static void AreEqual<T>(T expected, T actual, string message)
        {
            if (!Equals(expected, actual)) throw new InvalidOperationException(message);
        }
    }
}

namespace UnityEngine.Assertions.Must
{
    public static class MustExtensions
    {
    }
}

namespace UnityEngine.Networking.PlayerConnection
{
    public sealed class PlayerConnection
    {
        public static readonly PlayerConnection instance = new PlayerConnection();

        public void Send(Guid messageId, byte[] data)
        {
        }
    }
}

namespace UnityEngine.Networking
{
    public class CertificateHandler : IDisposable
    {
        public void Dispose()
        {
        }
    }

    public partial class DownloadHandler
    {
        public virtual byte[] data => new byte[0];
        public string text => Encoding.UTF8.GetString(data);
        public string error => "";
    }

    public sealed class DownloadHandlerFile : DownloadHandler
    {
        private readonly FileStream _file;

        public DownloadHandlerFile(string path, bool append = false)
        {
            Directory.CreateDirectory(Path.GetDirectoryName(path));
            _file = new FileStream(path, append ? FileMode.Append : FileMode.Create);
        }

        public bool removeFileOnAbort { get; set; }

        public override void Dispose() => _file.Dispose();

        protected override bool ReceiveData(byte[] data, int dataLength)
        {
            _file.Write(data, 0, dataLength);
            return true;
        }

        protected override void CompleteContent() => _file.Dispose();
    }

    public sealed class DownloadHandlerAssetBundle : DownloadHandler
    {
        public AssetBundle assetBundle => throw NoStandIn.For("bundles");
        public bool autoLoadAssetBundle { get; set; }
        public bool isDownloadComplete => throw NoStandIn.For("bundles");
    }

    public static class UnityWebRequestAssetBundle
    {
        public static UnityWebRequest GetAssetBundle(string uri, uint crc = 0) => throw NoStandIn.For("bundles");
        public static UnityWebRequest GetAssetBundle(Uri uri, uint crc = 0) => throw NoStandIn.For("bundles");
        public static UnityWebRequest GetAssetBundle(Uri uri, CachedAssetBundle cachedAssetBundle, uint crc = 0) => throw NoStandIn.For("bundles");
    }

    public sealed partial class UnityWebRequest
    {
        public const string kHttpVerbHEAD = "HEAD";

        public UnityWebRequest(string url, string method) : this(url, method, null, null)
        {
            if (method != kHttpVerbGET) throw NoStandIn.For("other requests than GET");
        }

        public string method => kHttpVerbGET;
        public int timeout { get; set; }
        public int redirectLimit { get; set; }
        public bool isDone => _sending.isDone;
        public ulong downloadedBytes => throw NoStandIn.For("bundles");
        public float downloadProgress => throw NoStandIn.For("bundles");
        public CertificateHandler certificateHandler { get; set; }
        public bool disposeCertificateHandlerOnDispose { get; set; }
        public bool disposeDownloadHandlerOnDispose { get; set; }
        public DownloadHandler downloadHandler => _handler;
        public string GetResponseHeader(string name) => throw NoStandIn.For("headers of answers");
        public static string EscapeURL(string text) => Uri.EscapeDataString(text);
    }
}

namespace Unity.Profiling
{
    public enum ProfilerCategory
    {
        Loading
    }
}
