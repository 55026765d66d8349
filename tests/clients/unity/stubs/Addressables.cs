// Stand-in for Unity.Addressables. A catalogue is the table that our writers lay out, given as JSON at its address;
// classes and properties are found by the names in it, as Unity finds them.
using System;
using System.Collections.Generic;
using System.IO;
using System.Linq;
using System.Reflection;
using System.Text;
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
    }
}

namespace UnityEngine.AddressableAssets
{
    using UnityEngine.AddressableAssets.Initialization;
    using UnityEngine.AddressableAssets.ResourceLocators;

    public static class Addressables
    {
        private static Dictionary<string, List<IResourceLocation>> _keys = new Dictionary<string, List<IResourceLocation>>();
        private static string _address;
        private static string _hash;

        public static ResourceManager ResourceManager { get; private set; } = new ResourceManager();

        /// <summary>Forget everything, as a new start of the app does.</summary>
        public static void Restart()
        {
            ResourceManager = new ResourceManager();
            _keys.Clear();
        }

        public static AsyncOperationHandle<TObject> LoadAssetAsync<TObject>(object key) => LoadAssetAsync<TObject>(_keys[(string)key].First());

        public static AsyncOperationHandle<TObject> LoadAssetAsync<TObject>(IResourceLocation location)
        {
            UnityEngine.Object.OnMainThread();
            return new AsyncOperationHandle<TObject>(ResourceManager.Provide(location));
        }

        public static AsyncOperationHandle<IList<IResourceLocation>> LoadResourceLocationsAsync(object key, Type type = null)
        {
            var found = _keys.TryGetValue((string)key, out var all) ? all.Where(each => type == null || each.ResourceType == type) : new IResourceLocation[0];
            return Started<IList<IResourceLocation>>(() => Task.FromResult<object>(found.ToList()));
        }

        public static AsyncOperationHandle<IResourceLocator> LoadContentCatalogAsync(string catalogPath, bool autoReleaseHandle, string providerSuffix = null)
        {
            return Started<IResourceLocator>(() => Read(catalogPath));
        }

        public static AsyncOperationHandle<List<string>> CheckForCatalogUpdates(bool autoReleaseHandle = true)
        {
            return Started<List<string>>(async () => await Text(HashOf(_address)) == _hash ? new List<string>() : new List<string> { _address });
        }

        public static AsyncOperationHandle<List<IResourceLocator>> UpdateCatalogs(IEnumerable<string> catalogs = null, bool autoReleaseHandle = true)
        {
            return Started<List<IResourceLocator>>(async () =>
            {
                foreach (var each in catalogs) await Read(each);
                return new List<IResourceLocator>();
            });
        }

        public static void Release<TObject>(AsyncOperationHandle<TObject> handle) => handle.Operation.Release();

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
                operation.Complete(null, false, fault);
            }
        }

        private static string HashOf(string address) => address.Substring(0, address.LastIndexOf('.')) + ".hash";

        public static Action<UnityWebRequest> WebRequestOverride { get; set; }

        private static async Task<string> Text(string address)
        {
            var request = new UnityWebRequest { url = address };
            WebRequestOverride?.Invoke(request);
            using (var memory = new MemoryStream())
            {
                await Http.Fetch(address, memory, request.Headers);
                return Encoding.UTF8.GetString(memory.ToArray());
            }
        }

        private static async Task<object> Read(string address)
        {
            _hash = await Text(HashOf(address));
            var table = Json.Parse(await Text(address + ".table"));
            _address = address;
            var locations = new List<IResourceLocation>();
            foreach (var each in table.In("locations").List()) locations.Add(Location(each, locations));
            var places = (Dictionary<string, object>)table.In("keys");
            _keys = places.ToDictionary(each => each.Key, each => each.Value.List().Select(place => locations[(int)place.Whole()]).ToList());
            foreach (var provider in table.In("providers").List()) Register(provider);
            return null;
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
            // Unity's GameObject is in an assembly of its own.
            var name = assembly == "" ? told.In("name").Text() : $"{told.In("name").Text()}, {assembly.Replace("UnityEngine.CoreModule", "Stubs")}";
            return Type.GetType(name, true);
        }

        private static void Register(object told)
        {
            var type = Named(told);
            if (ResourceManager.ResourceProviders.Any(each => each.GetType() == type)) return;
            ResourceManager.ResourceProviders.Add((IResourceProvider)Activator.CreateInstance(type));
        }
    }
}

namespace UnityEngine.Networking
{
    public sealed class UnityWebRequest
    {
        public readonly Dictionary<string, string> Headers = new Dictionary<string, string>();

        public string url { get; set; }

        public void SetRequestHeader(string name, string value) => Headers[name] = value;
    }
}
