using System;
using System.Collections.Generic;
using System.IO;
using System.Linq;
using System.Threading.Tasks;
using UnityEngine;
using UnityEngine.AddressableAssets;
using UnityEngine.AddressableAssets.Initialization;
using UnityEngine.Networking;
using UnityEngine.ResourceManagement.AsyncOperations;
using UnityEngine.Scripting;

namespace Capture2vr
{
    /// <summary>The collection that this app shows: where it is, whose signature it bears, what the device has of it.</summary>
    [Preserve]
    public static class Catalogue
    {
        private static readonly AccessHeaders Access = new AccessHeaders(); // first: what follows is made of it

        /// <summary>Bytes that assets may take on the device; set it before the catalogue is opened.</summary>
        public static long CacheBytes { get; set; } = 512L << 20;

        private const string BaseUrlProperty = "Capture2vr.Catalogue.BaseUrl";

        private static string _baseUrl;
        private static Task _updating;

        /// <summary>
        /// Below which address the objects are. Catalogues do not say it, but name this property, so that one catalogue
        /// serves any host.
        /// </summary>
        [Preserve]
        public static string BaseUrl
        {
            get => _baseUrl;
            set
            {
                _baseUrl = value.TrimEnd('/');
                // Addressables remembers what it once read here.
                AddressablesRuntimeProperties.SetPropertyValue(BaseUrlProperty, _baseUrl);
            }
        }

        /// <summary>The files on this device.</summary>
        public static FileCache Cache { get; private set; }

        /// <summary>The versions that this device has seen.</summary>
        public static Versions Versions { get; private set; }

        /// <summary>What the signed catalogue allows, or null where the app gave no keys.</summary>
        public static Trust Trust { get; private set; }

        /// <summary>
        /// HTTP headers for private assets, such as Authorization with an access key; sent to the server of the catalogue alone,
        /// with its catalogues and its files.
        /// </summary>
        public static IReadOnlyDictionary<string, string> Headers
        {
            get => Access.Current;
            set => Access.Current = value;
        }

        /// <summary>
        /// Returns new headers when the server has refused the present ones, so that a key may expire while the app runs. Called
        /// away from the main thread. Null where there is no way to get any.
        /// </summary>
        public static Func<Task<IReadOnlyDictionary<string, string>>> RefreshHeaders
        {
            get => Access.Renewal;
            set => Access.Renewal = value;
        }

        /// <summary>How files are fetched; to be replaced by apps with a way of their own, before the catalogue is opened.</summary>
        public static Fetch Fetch { get; set; } = Access.Fetch;

        /// <summary>Name of the catalogue's file that the installed Addressables reads.</summary>
        public static string FileName
        {
            get
            {
#if CAPTURE2VR_ADDRESSABLES_4
                return "catalog_v3.bin";
#elif CAPTURE2VR_ADDRESSABLES_2 && !ENABLE_JSON_CATALOG
                return "catalog_v2.bin";
#elif ENABLE_BINARY_CATALOG && !CAPTURE2VR_ADDRESSABLES_2
                return "catalog_v1.bin";
#else
                return "catalog.json";
#endif
            }
        }

        /// <summary>
        /// Make the assets of a collection loadable as captures/&lt;key&gt;. Throws CaptureFault UNREACHABLE where its
        /// catalogue cannot be had and this device does not have it from an earlier visit.
        /// </summary>
        /// <param name="baseUrl">of the bucket or CDN</param>
        /// <param name="keys">public keys in base64, as GET /v1/keys gives them; with none no signature is asked for</param>
        public static async Task OpenAsync(string baseUrl, string collection = "default", params string[] keys)
        {
            BaseUrl = baseUrl;
            Access.Server = BaseUrl;
            Addressables.WebRequestOverride = SetHeaders;
            Prepare(collection, keys);
            var headers = Headers;
            var fault = await Load(collection);
            // Addressables does not tell a refusal from another fault.
            if (fault != null && RefreshHeaders != null && await Access.RenewAsync(headers)) fault = await Load(collection);
            if (fault == null) return;
            throw new CaptureFault(CaptureFault.Unreachable, $"the catalogue of {collection} cannot be had: {fault.Message}",
                "Check the connection", fault);
        }

        /// <summary>
        /// Take newer catalogues where there are any. Whoever asks while somebody's question is under way gets its answer.
        /// Never throws: without a network the assets of the catalogue at hand go on.
        /// </summary>
        public static Task UpdateAsync()
        {
            if (_updating == null || _updating.IsCompleted) _updating = Update();
            return _updating;
        }

        /// <summary>The fault of this package behind an exception of Addressables, or null.</summary>
        public static CaptureFault FaultOf(Exception exception)
        {
            while (exception != null && !(exception is CaptureFault)) exception = exception.InnerException;
            return (CaptureFault)exception;
        }

        private static async Task<Exception> Load(string collection)
        {
            var loading = Addressables.LoadContentCatalogAsync($"{BaseUrl}/collections/{collection}/unity/{FileName}", false);
            await loading.Task;
            var fault = loading.Status == AsyncOperationStatus.Succeeded ? null : loading.OperationException;
            Addressables.Release(loading);
            return fault;
        }

        /// <summary>Addressables fetches the catalogues itself.</summary>
        private static void SetHeaders(UnityWebRequest request)
        {
            foreach (var header in Access.For(request.url)) request.SetRequestHeader(header.Key, header.Value);
        }

        private static void Prepare(string collection, string[] keys)
        {
            // Not the folder for caches, which systems clear: an asset seen once must be there without a network.
            var folder = Path.Combine(Application.persistentDataPath, "capture2vr");
            Directory.CreateDirectory(folder);
            Cache = Cache ?? new FileCache(Path.Combine(folder, "files"), CacheBytes, Fetch);
            Versions = Versions ?? new Versions(Path.Combine(folder, "versions.txt"));
            var raw = keys.Select(Convert.FromBase64String).ToList();
            Trust = raw.Count == 0 ? null : new Trust(BaseUrl, collection, raw, folder, Cache, Versions, Fetch);
        }

        private static async Task Update()
        {
            var checking = Addressables.CheckForCatalogUpdates(false);
            await checking.Task;
            if (checking.Status == AsyncOperationStatus.Succeeded && checking.Result.Count > 0)
            {
                var updating = Addressables.UpdateCatalogs(checking.Result, false);
                await updating.Task;
                Addressables.Release(updating);
            }
            Addressables.Release(checking);
        }

        /// <summary>Statics outlive play mode where the editor does not reload them.</summary>
        [RuntimeInitializeOnLoadMethod(RuntimeInitializeLoadType.SubsystemRegistration)]
        private static void Forget()
        {
            Cache = null;
            Versions = null;
            Trust = null;
            Headers = null;
            RefreshHeaders = null;
            _updating = null;
        }
    }
}
