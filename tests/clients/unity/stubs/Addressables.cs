// Stand-in for Unity.Addressables. A catalogue is the table that our writers lay out, given as JSON at its address;
// classes and properties are found by the names in it, as Unity finds them.
using System;
using System.Collections.Generic;
using System.Linq;
using System.Reflection;
using System.Text.RegularExpressions;
using System.Threading.Tasks;
using Capture2vr;
using UnityEngine.Networking;
using UnityEngine.ResourceManagement;
using UnityEngine.ResourceManagement.AsyncOperations;
using UnityEngine.ResourceManagement.ResourceLocations;
using UnityEngine.ResourceManagement.ResourceProviders;

namespace UnityEngine.AddressableAssets.Initialization
{
    public static class AddressablesRuntimeProperties
    {
        private static readonly Dictionary<string, string> Known = new Dictionary<string, string>();

        public static void SetPropertyValue(string name, string val) => Known[name] = val;

        public static string Evaluate(string text) => Regex.Replace(text, "{(.*?)}", match => Value(match.Groups[1].Value));

        private static string Value(string name)
        {
            if (Known.TryGetValue(name, out var known)) return known;
            var dot = name.LastIndexOf('.');
            var type = AppDomain.CurrentDomain.GetAssemblies().Select(each => each.GetType(name.Substring(0, dot))).First(each => each != null);
            return Known[name] = type.GetProperty(name.Substring(dot + 1), BindingFlags.Static | BindingFlags.Public).GetValue(null).ToString();
        }
    }
}

namespace UnityEngine.AddressableAssets.ResourceLocators
{
    public interface IResourceLocator
    {
        string LocatorId { get; }
        IEnumerable<object> Keys { get; }
        IEnumerable<IResourceLocation> AllLocations { get; } // only where catalogues are binary
        bool Locate(object key, Type type, out IList<IResourceLocation> locations);
    }

    /// <summary>What a catalogue says, as of the moment it was read. Its id is the catalogue's address.</summary>
    public sealed class ResourceLocationMap : IResourceLocator
    {
        private readonly Dictionary<string, List<IResourceLocation>> _keys;

        public ResourceLocationMap(string id, Dictionary<string, List<IResourceLocation>> keys)
        {
            LocatorId = id;
            _keys = keys;
        }

        public string LocatorId { get; }
        public IEnumerable<object> Keys => _keys.Keys;
        public IEnumerable<IResourceLocation> AllLocations => _keys.Values.SelectMany(each => each).Distinct();

        public bool Locate(object key, Type type, out IList<IResourceLocation> locations)
        {
            locations = _keys.TryGetValue((string)key, out var all) ? all.Where(each => type == null || type.IsAssignableFrom(each.ResourceType)).ToList() : null;
            if (locations != null && locations.Count == 0) locations = null;
            return locations != null;
        }
    }
}

namespace UnityEngine.AddressableAssets
{
    using UnityEngine.AddressableAssets.Initialization;
    using UnityEngine.AddressableAssets.ResourceLocators;

    public static class Addressables
    {
        private static readonly List<IResourceLocator> Locators = new List<IResourceLocator>();
        private static readonly Dictionary<string, string> Kept = new Dictionary<string, string>();
        private static bool _initialized;
        private static Operation _starting;

        public static ResourceManager ResourceManager { get; private set; } = new ResourceManager();

        /// <summary>Ids of the catalogues that were updated, in order.</summary>
        public static readonly List<string> Updated = new List<string>();

        /// <summary>Whether the app was built with settings, and so has a catalogue of its own.</summary>
        public static bool HasSettings { get; set; }

        public static Action<UnityWebRequest> WebRequestOverride { get; set; }

        /// <summary>Forget everything, as a new start of the app does.</summary>
        public static void Restart()
        {
            ResourceManager = new ResourceManager();
            Locators.Clear();
            Updated.Clear();
            _initialized = false;
            _starting = null;
            HasSettings = true;
        }

        /// <summary>
        /// Whoever asks while somebody's handle is valid gets that one, and no share in it: it is whose it was. Later the first
        /// locator is the answer, whether there is one or not: the app's own, if it was built with settings.
        /// </summary>
        public static AsyncOperationHandle<IResourceLocator> InitializeAsync(bool autoReleaseHandle = true)
        {
            if (_starting != null && _starting.Users > 0) return new AsyncOperationHandle<IResourceLocator>(_starting);
            if (_starting != null && Locators.Count == 0 && !HasSettings) throw new ArgumentOutOfRangeException("index");
            var handle = Started<IResourceLocator>(async () =>
            {
                await Task.Yield();
                _initialized = true;
                return null;
            });
            _starting = handle.Operation;
            if (autoReleaseHandle) handle.Completed += Release;
            return handle;
        }

        /// <summary>Of several catalogues with the key, the first that was loaded has it.</summary>
        public static AsyncOperationHandle<TObject> LoadAssetAsync<TObject>(object key)
        {
            return LoadAssetAsync<TObject>(All(key, typeof(TObject)).First());
        }

        public static AsyncOperationHandle<TObject> LoadAssetAsync<TObject>(IResourceLocation location)
        {
            UnityEngine.Object.OnMainThread();
            return new AsyncOperationHandle<TObject>(ResourceManager.Provide(location));
        }

        /// <summary>Loads and keeps what is a bundle of the key's locations and of what they depend on; nothing else.</summary>
        public static AsyncOperationHandle<IList<IAssetBundleResource>> DownloadDependenciesAsync(object key, bool autoReleaseHandle = false)
        {
            return Started<IList<IAssetBundleResource>>(async () =>
            {
                var wanted = All(key, null).SelectMany(each => each.Dependencies.Concat(new[] { each })).Where(each => each.ResourceType == typeof(IAssetBundleResource));
                var operations = wanted.Select(ResourceManager.Provide).ToList();
                foreach (var each in operations) await each.Done.Task;
                var found = operations.Select(each => (IAssetBundleResource)each.Done.Task.Result).ToList();
                foreach (var each in operations) each.Release();
                return found;
            });
        }

        public static AsyncOperationHandle<IList<IResourceLocation>> LoadResourceLocationsAsync(object key, Type type = null)
        {
            return Started<IList<IResourceLocation>>(() => Task.FromResult<object>(All(key, type)));
        }

        public static AsyncOperationHandle<IResourceLocator> LoadContentCatalogAsync(string catalogPath, bool autoReleaseHandle, string providerSuffix = null)
        {
            return Started<IResourceLocator>(async () =>
            {
                if (!_initialized) throw new InvalidOperationException("No catalog provider registered for extension");
                var found = await Read(catalogPath);
                Locators.Add(found);
                return found;
            });
        }

        public static AsyncOperationHandle<List<IResourceLocator>> UpdateCatalogs(IEnumerable<string> catalogs = null, bool autoReleaseHandle = true)
        {
            return Started<List<IResourceLocator>>(async () =>
            {
                var found = new List<IResourceLocator>();
                foreach (var each in catalogs) found.Add(await Read(each));
                foreach (var each in found) Locators[Locators.FindIndex(old => old.LocatorId == each.LocatorId)] = each;
                Updated.AddRange(catalogs);
                return found;
            });
        }

        public static void AddResourceLocator(IResourceLocator locator, string localCatalogHash = null, IResourceLocation remoteCatalogLocation = null)
        {
            if (!_initialized) throw new InvalidOperationException("what is added before the start is forgotten by it");
            Locators.Add(locator);
        }

        public static void RemoveResourceLocator(IResourceLocator locator) => Locators.Remove(locator);

        public static IEnumerable<IResourceLocator> ResourceLocators => Locators;

        public static void Release<TObject>(AsyncOperationHandle<TObject> handle) => handle.Operation.Release();

        private static List<IResourceLocation> All(object key, Type type)
        {
            return Locators.SelectMany(each => each.Locate(key, type, out var found) ? found : new IResourceLocation[0]).ToList();
        }

        private static AsyncOperationHandle<T> Started<T>(Func<Task<object>> work)
        {
            UnityEngine.Object.OnMainThread();
            var operation = new Operation();
            Run(operation, work);
            return new AsyncOperationHandle<T>(operation);
        }

        private static async void Run(Operation operation, Func<Task<object>> work)
        {
            try
            {
                operation.Complete(await work(), true, null);
            }
            catch (Exception fault)
            {
                // Unity's message tells no cause, and its exception holds none.
                operation.Complete(null, false, new Exception($"Unable to load: {fault.Message}"));
            }
        }

        private static async Task<string> Text(string address)
        {
            var text = new DownloadHandlerBuffer();
            using (var request = new UnityWebRequest(address, UnityWebRequest.kHttpVerbGET, text, null))
            {
                WebRequestOverride?.Invoke(request);
                var sending = request.SendWebRequest();
                while (!sending.isDone) await Task.Yield();
                // A device keeps the last one, and takes it where it gets no other.
                var kept = Application.persistentDataPath + " " + address;
                if (request.result == UnityWebRequest.Result.Success) Kept[kept] = text.text;
                if (!Kept.ContainsKey(kept)) throw new Exception(request.error);
                return Kept[kept];
            }
        }

        private static async Task<IResourceLocator> Read(string address)
        {
            var table = Json.Parse(await Text(address + ".table"));
            var locations = new List<IResourceLocation>();
            foreach (var each in table.In("locations").List()) locations.Add(Location(each, locations));
            var places = (Dictionary<string, object>)table.In("keys");
            foreach (var provider in table.In("providers").List()) Register(provider);
            return new ResourceLocationMap(address, places.ToDictionary(each => each.Key,
                each => each.Value.List().Select(place => locations[(int)place.Whole()]).ToList()));
        }

        private static IResourceLocation Location(object told, List<IResourceLocation> before)
        {
            var dependencies = told.In("dependencies").List().Select(each => before[(int)each.Whole()]).ToArray();
            var id = AddressablesRuntimeProperties.Evaluate(told.In("internal_id").Text());
            return new ResourceLocationBase(told.In("key").Text(), id, told.In("provider").Text(), Named(told.In("type")), dependencies)
            {
                Data = Data(told.In("data"))
            };
        }

        private static object Data(object told)
        {
            if (told is string text) return text;
            return new AssetBundleRequestOptions { Hash = told.In("hash").Text(), BundleName = told.In("name").Text(), BundleSize = told.In("size").Whole() };
        }

        private static Type Named(object told)
        {
            var assembly = told.In("assembly").Text();
            // Unity's types are in assemblies of their own.
            if (assembly.StartsWith("Unity", StringComparison.Ordinal)) assembly = "Stubs";
            return Type.GetType(assembly == "" ? told.In("name").Text() : $"{told.In("name").Text()}, {assembly}", true);
        }

        private static void Register(object told)
        {
            var type = Named(told);
            if (ResourceManager.ResourceProviders.Any(each => each.GetType() == type)) return;
            ResourceManager.ResourceProviders.Add((IResourceProvider)Activator.CreateInstance(type));
        }
    }
}
