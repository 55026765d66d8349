using System;
using System.Collections.Generic;
using System.IO;
using System.Linq;
using System.Threading.Tasks;
using UnityEngine;
using UnityEngine.AddressableAssets;
using UnityEngine.AddressableAssets.Initialization;
using UnityEngine.Networking;
using UnityEngine.ResourceManagement.ResourceLocations;
using UnityEngine.Scripting;

namespace Capture2vr
{
    /// <summary>The collections that this app has opened, from one server or from several.</summary>
    [Preserve]
    public static class Catalogue
    {
        private const string BaseUrlProperty = "Capture2vr.Catalogue.BaseUrl";

        private static readonly IReadOnlyDictionary<string, string> NoHeaders = new Dictionary<string, string>();

        private static readonly object Gate = new object();
        private static readonly List<AccessHeaders> Servers = new List<AccessHeaders>();
        private static readonly List<OpenCollection> Collections = new List<OpenCollection>();
        private static readonly List<OpenCollection> Opening = new List<OpenCollection>(); // for the first time
        private static FileCache _cache;

        /// <summary>
        /// What the addresses of all files begin with in Unity's catalogues: no host, since one catalogue serves any. The
        /// collection that a file belongs to knows the host. It begins with http because Addressables counts as downloads
        /// only what does.
        /// </summary>
        [Preserve]
        public static string BaseUrl => "http://capture2vr.invalid";

        /// <summary>Bytes that assets may take on the device; set it before the first collection is opened.</summary>
        public static long CacheBytes { get; set; } = (Background.HasThreads ? 512L : 64L) << 20; // in a browser all of it is in memory

        /// <summary>
        /// How files are fetched: by .NET's HTTP client, Http.Fetch, and in a browser by UnityWebRequest, UnityHttp.Fetch, which
        /// may be set elsewhere too. One of the app's own is given AccessTo's headers.
        /// </summary>
        public static Transport Transport { get; set; } =
#if UNITY_WEBGL && !UNITY_EDITOR
            UnityHttp.Fetch;
#else
            Http.Fetch;
#endif

        /// <summary>The collections that are open, the first one first.</summary>
        public static IReadOnlyList<OpenCollection> Opened => Collections;

        /// <summary>The files on this device, of all collections.</summary>
        public static FileCache Cache => _cache = _cache ?? new FileCache(Path.Combine(Folder, "files"), CacheBytes, FetchAsync);

        // Not the folder for caches, which systems clear: an asset seen once must be there without a network.
        internal static string Folder => Path.Combine(Application.persistentDataPath, "capture2vr");

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
        /// The HTTP headers for the private assets below an address, such as Authorization with an access key; to be set before
        /// a collection there is opened. No other address gets them.
        /// </summary>
        public static AccessHeaders AccessTo(string baseUrl)
        {
            var address = baseUrl.TrimEnd('/');
            lock (Gate)
            {
                var known = Servers.FirstOrDefault(each => each.BaseUrl == address);
                if (known == null) Servers.Add(known = new AccessHeaders(address, Send));
                return known;
            }
        }

        /// <summary>
        /// Open a collection: its assets are then loadable, by CapturedAsset or as captures/&lt;key&gt;. One that is open
        /// already is looked through for newer versions instead, and believes the new keys too. Throws CaptureFault
        /// UNREACHABLE where its catalogue cannot be had and this device does not have it from an earlier visit,
        /// FILE_MISSING where the server has no such collection, ACCESS_REFUSED, and CATALOGUE_UNREADABLE; ArgumentException for
        /// a key that is none.
        /// </summary>
        /// <param name="baseUrl">of the bucket or CDN</param>
        /// <param name="keys">public keys in base64, as GET /v1/keys gives them; with none no signature is asked for</param>
        public static async Task<OpenCollection> OpenAsync(string baseUrl, string name = "default", params string[] keys)
        {
            var believed = keys.Select(PublicKey).ToList(); // before anything is changed
            Addressables.WebRequestOverride -= SetHeaders; // once, beside what the app itself does to requests
            Addressables.WebRequestOverride += SetHeaders;
            AddressablesRuntimeProperties.SetPropertyValue(BaseUrlProperty, BaseUrl);
            var address = baseUrl.TrimEnd('/');
            var known = Collections.Concat(Opening).FirstOrDefault(each => each.BaseUrl == address && each.Name == name);
            var collection = known ?? new OpenCollection(AccessTo(address), name);
            collection.Believe(believed);
            if (known == null) Opening.Add(collection); // who opens it meanwhile gets the same one
            try
            {
                await collection.OpenAsync();
                if (!Collections.Contains(collection)) Collections.Add(collection);
            }
            finally
            {
                Opening.Remove(collection);
            }
            return collection;
        }

        private static byte[] PublicKey(string text)
        {
            try
            {
                var key = Convert.FromBase64String(text);
                if (key.Length == Ed25519.KeyBytes) return key;
            }
            catch (FormatException)
            {
                // No base64: told below.
            }
            throw new ArgumentException($"\"{text}\" is no public key: take one of {Ed25519.KeyBytes} bytes in base64, as GET /v1/keys gives it");
        }

        /// <summary>Take the newer catalogues of all open collections. Without a network, what there is stays.</summary>
        public static Task UpdateAsync() => Task.WhenAll(Collections.Select(each => each.UpdateAsync()));

        /// <summary>The fault that an exception of Addressables wraps, or null.</summary>
        public static CaptureFault FaultOf(Exception exception)
        {
            while (exception != null && !(exception is CaptureFault)) exception = exception.InnerException;
            return (CaptureFault)exception;
        }

        /// <summary>
        /// The collection whose catalogue has a location, as it is now or was before the last update. Where two have the
        /// same, with files of the same hashes, either serves. Throws CaptureFault LOCATION_INVALID.
        /// </summary>
        internal static OpenCollection Of(IResourceLocation location)
        {
            return Collections.FirstOrDefault(each => each.Has(location)) ?? throw new CaptureFault(CaptureFault.LocationInvalid,
                $"{location.PrimaryKey}: no open collection has it", "Open it with Catalogue.OpenAsync, and ask for the location again");
        }

        internal static Task FetchAsync(string url, Stream into)
        {
            return Access(url)?.Fetch(url, into) ?? Send(url, into, NoHeaders);
        }

        /// <summary>By the transport of the moment: who has asked for a server's headers may set another one afterwards.</summary>
        private static Task Send(string url, Stream into, IReadOnlyDictionary<string, string> headers) => Transport(url, into, headers);

        /// <summary>Addressables fetches the catalogues itself.</summary>
        private static void SetHeaders(UnityWebRequest request)
        {
            var access = Access(request.url);
            if (access == null) return;
            foreach (var header in access.For(request.url)) request.SetRequestHeader(header.Key, header.Value);
        }

        /// <summary>The headers for an address: those of the longest address that it lies below, or null.</summary>
        private static AccessHeaders Access(string url)
        {
            lock (Gate) return Servers.Where(each => each.Covers(url)).OrderBy(each => each.BaseUrl.Length).LastOrDefault();
        }

        /// <summary>Statics outlive play mode where the editor does not reload them.</summary>
        [RuntimeInitializeOnLoadMethod(RuntimeInitializeLoadType.SubsystemRegistration)]
        private static void Forget()
        {
            _cache = null;
            Collections.Clear();
            Opening.Clear();
            lock (Gate) Servers.Clear();
            SharedLevel.Forget();
        }
    }
}
