// Stand-ins for com.unity.addressables, of which Unity builds two assemblies; this is Unity.ResourceManager. Operations
// are shared by location and counted, and dependencies are loaded first and released last, as Unity's are.
using System;
using System.Collections.Generic;
using System.Linq;
using System.Threading.Tasks;
using UnityEngine;
using UnityEngine.ResourceManagement.AsyncOperations;
using UnityEngine.ResourceManagement.ResourceLocations;
using UnityEngine.ResourceManagement.ResourceProviders;

namespace UnityEngine.ResourceManagement.AsyncOperations
{
    public enum AsyncOperationStatus
    {
        None,
        Succeeded,
        Failed
    }

    public struct DownloadStatus
    {
        public long TotalBytes;
        public long DownloadedBytes;
        public bool IsDone;
        public float Percent => TotalBytes > 0 ? (float)DownloadedBytes / TotalBytes : IsDone ? 1 : 0;
    }

    public sealed class Operation
    {
        public readonly TaskCompletionSource<object> Done = new TaskCompletionSource<object>();
        public readonly List<Operation> Dependencies = new List<Operation>();
        public AsyncOperationStatus Status;
        public Exception Fault;
        public int Users = 1;
        public Action Freed = () => { };
        public Func<DownloadStatus> Downloading;
        public Func<bool> Waiting;

        public void Complete(object result, bool status, Exception fault)
        {
            UnityEngine.Object.OnMainThread();
            if (Status != AsyncOperationStatus.None) throw new InvalidOperationException("an operation that is complete completes again");
            Status = status ? AsyncOperationStatus.Succeeded : AsyncOperationStatus.Failed;
            Fault = fault;
            Done.SetResult(result);
        }

        public void Release()
        {
            if (Users == 0) throw new InvalidOperationException("an operation is released too often");
            if (--Users > 0) return;
            Freed();
            foreach (var each in Dependencies) each.Release();
        }
    }

    /// <summary>Without Unity's Task, which its manual says is not there on WebGL: the client must do without.</summary>
    public struct AsyncOperationHandle<TObject>
    {
        private readonly Operation _operation;

        public AsyncOperationHandle(Operation operation)
        {
            _operation = operation;
        }

        public Operation Operation => _operation;
        public TObject Result => (TObject)_operation.Done.Task.Result;
        public AsyncOperationStatus Status => _operation.Status;
        public Exception OperationException => _operation.Fault;
        public bool IsDone => _operation.Status != AsyncOperationStatus.None;
        public bool IsValid() => _operation != null && _operation.Users > 0;

        /// <summary>Comes in a frame after the end, also where it has ended already.</summary>
        public event Action<AsyncOperationHandle<TObject>> Completed
        {
            add => Tell(value);
            remove => throw new NotSupportedException();
        }

        public async Task<TObject> Ended() => (TObject)await _operation.Done.Task;

        private async void Tell(Action<AsyncOperationHandle<TObject>> told)
        {
            var handle = this;
            await _operation.Done.Task;
            await Task.Yield();
            told(handle);
        }
    }
}

namespace UnityEngine.ResourceManagement.ResourceLocations
{
    public interface IResourceLocation
    {
        string InternalId { get; }
        string ProviderId { get; }
        IList<IResourceLocation> Dependencies { get; }
        object Data { get; }
        string PrimaryKey { get; }
        Type ResourceType { get; }
    }

    public class ResourceLocationBase : IResourceLocation
    {
        public ResourceLocationBase(string name, string id, string providerId, Type t, params IResourceLocation[] dependencies)
        {
            PrimaryKey = name;
            InternalId = id;
            ProviderId = providerId;
            ResourceType = t;
            Dependencies = dependencies;
        }

        public string InternalId { get; }
        public string ProviderId { get; }
        public IList<IResourceLocation> Dependencies { get; }
        public object Data { get; set; }
        public string PrimaryKey { get; set; }
        public Type ResourceType { get; }
    }
}

namespace UnityEngine.ResourceManagement.ResourceProviders
{
    [Flags]
    public enum ProviderBehaviourFlags
    {
        None = 0,
        CanProvideWithFailedDependencies = 1
    }

    public class AssetBundleRequestOptions
    {
        public string Hash { get; set; }
        public uint Crc { get; set; }
        public string BundleName { get; set; }
        public long BundleSize { get; set; }
    }

    public interface IAssetBundleResource
    {
        AssetBundle GetAssetBundle();
    }

    public interface IResourceProvider
    {
        string ProviderId { get; }
        ProviderBehaviourFlags BehaviourFlags { get; }
        void Provide(ProvideHandle provideHandle);
        void Release(IResourceLocation location, object asset);
    }

    public abstract class ResourceProviderBase : IResourceProvider
    {
        protected string m_ProviderId;
        protected ProviderBehaviourFlags m_BehaviourFlags = ProviderBehaviourFlags.None;

        public virtual string ProviderId => m_ProviderId ?? GetType().FullName;
        ProviderBehaviourFlags IResourceProvider.BehaviourFlags => m_BehaviourFlags;

        public virtual void Release(IResourceLocation location, object obj)
        {
        }

        public abstract void Provide(ProvideHandle provideHandle);
    }

    public struct ProvideHandle
    {
        private readonly Operation _operation;

        public ProvideHandle(ResourceManager manager, IResourceLocation location, Operation operation)
        {
            ResourceManager = manager;
            Location = location;
            _operation = operation;
        }

        public ResourceManager ResourceManager { get; }
        public IResourceLocation Location { get; }

        /// <summary>All of them or none: Unity empties the group of which one fails, also for who can do without.</summary>
        public void GetDependencies(IList<object> list)
        {
            if (_operation.Dependencies.Any(each => each.Status != AsyncOperationStatus.Succeeded)) return;
            foreach (var each in _operation.Dependencies) list.Add(each.Done.Task.Result);
        }

        public void SetProgressCallback(Func<float> callback)
        {
        }

        public void SetDownloadProgressCallbacks(Func<DownloadStatus> callback) => _operation.Downloading = callback;
        public void SetWaitForCompletionCallback(Func<bool> callback) => _operation.Waiting = callback;
        public void Complete<T>(T result, bool status, Exception exception) => _operation.Complete(result, status, exception);
    }
}

namespace UnityEngine.ResourceManagement
{
    public sealed class ResourceManager
    {
        private readonly Dictionary<string, Operation> _operations = new Dictionary<string, Operation>();

        public readonly List<IResourceProvider> ResourceProviders = new List<IResourceProvider>();

        /// <summary>What was loaded and released, in order.</summary>
        public readonly List<string> Log = new List<string>();

        public int Loaded => _operations.Count;

        public Operation Provide(IResourceLocation location)
        {
            var key = KeyOf(location);
            if (_operations.TryGetValue(key, out var shared))
            {
                shared.Users++;
                return shared;
            }
            var made = _operations[key] = new Operation();
            made.Dependencies.AddRange(location.Dependencies.Select(Provide));
            Run(location, made);
            return made;
        }

        /// <summary>Locations are the same whose ids and providers are, and those of what they depend on.</summary>
        private static string KeyOf(IResourceLocation location)
        {
            return string.Join(" ", new[] { location }.Concat(location.Dependencies).Select(each => $"{each.ProviderId} {each.InternalId}"));
        }

        private async void Run(IResourceLocation location, Operation operation)
        {
            foreach (var each in operation.Dependencies) await each.Done.Task;
            var provider = ResourceProviders.Single(each => each.ProviderId == location.ProviderId);
            operation.Freed = () => Free(provider, location, operation);
            var failed = operation.Dependencies.FirstOrDefault(each => each.Status == AsyncOperationStatus.Failed);
            if (failed != null && (provider.BehaviourFlags & ProviderBehaviourFlags.CanProvideWithFailedDependencies) == 0)
            {
                operation.Complete(null, false, new Exception("a dependency failed", failed.Fault));
                return;
            }
            Log.Add("provide " + location.PrimaryKey);
            provider.Provide(new ProvideHandle(this, location, operation));
        }

        /// <summary>Unity asks a provider to release only what it has provided.</summary>
        private void Free(IResourceProvider provider, IResourceLocation location, Operation operation)
        {
            _operations.Remove(KeyOf(location));
            if (operation.Status != AsyncOperationStatus.Succeeded) return;
            Log.Add("release " + location.PrimaryKey);
            provider.Release(location, operation.Done.Task.Result);
        }
    }
}
