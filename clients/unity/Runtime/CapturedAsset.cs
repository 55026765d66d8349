using System;
using System.Linq;
using System.Threading.Tasks;
using UnityEngine;
using UnityEngine.AddressableAssets;
using UnityEngine.ResourceManagement.AsyncOperations;
using UnityEngine.ResourceManagement.ResourceLocations;

namespace Capture2vr
{
    /// <summary>Shows an asset by its key as a child of this object, takes newer versions, and frees everything at the end.</summary>
    [AddComponentMenu("Capture2VR/Captured Asset")]
    public sealed class CapturedAsset : MonoBehaviour
    {
        // Seconds. The pause doubles with every failure: a damaged version would else be downloaded again and again.
        private const float LongestPause = 600;

        [Tooltip("Key of the asset in its collection")]
        [SerializeField] private string key = "";

        [Tooltip("Stand it on the floor ahead of the main camera once it is there")]
        [SerializeField] private bool placeAhead = true;

        [Tooltip("Seconds between looks for a newer version; 0 for none")]
        [SerializeField] private float followSeconds = 10;

        private AsyncOperationHandle<GameObject> _handle;
        private GameObject _shown;
        private int _turn; // of showing and releasing: what comes late must see that it is not wanted any more
        private float _nextLook;
        private float _pause; // seconds between looks
        private bool _looking;
        private bool _wanted; // from showing to releasing, whether it could be loaded or not
        private bool _placed;

        /// <summary>A version stands there.</summary>
        public event Action<CapturedAsset> Shown;

        /// <summary>It cannot be shown; CaptureFault where the reason is known.</summary>
        public event Action<Exception> Failed;

        public string Key
        {
            get => key;
            set => key = value;
        }

        /// <summary>What is known of the asset, or null while none is shown.</summary>
        public CapturedInfo Info => _shown == null ? null : _shown.GetComponent<CapturedInfo>();

        private async void Start()
        {
            if (key != "") await ShowAsync();
        }

        private async void Update()
        {
            if (_wanted && followSeconds > 0 && !_looking && Time.unscaledTime >= _nextLook) await FollowAsync();
        }

        private void OnDestroy() => Release();

        /// <summary>
        /// Load the asset and show it, instead of what was shown. Faults go to Failed; what cannot be had now is tried again
        /// when newer versions are looked for.
        /// </summary>
        public async Task ShowAsync()
        {
            Release();
            _wanted = true;
            _pause = followSeconds;
            await LookAsync(() => Task.CompletedTask);
        }

        /// <summary>
        /// Take the newer version if there is one. The old one stands until the new one is whole, and stays if that cannot
        /// be had or is refused. An asset that was removed goes, and comes again when it is restored.
        /// </summary>
        public Task FollowAsync() => LookAsync(Catalogue.UpdateAsync);

        /// <summary>Free the asset. The files stay on the device.</summary>
        public void Release()
        {
            _wanted = false;
            Free();
        }

        /// <summary>Stand it on the floor ahead of a viewer, or at a comfortable height where it is small.</summary>
        public void PlaceAhead(Transform viewer, float floor = 0)
        {
            var info = Info;
            if (info == null) return;
            var place = Placement.Ahead(Floats(viewer.position), Floats(viewer.forward), Floats(info.Size * Scale), floor);
            transform.position = new Vector3(place.X, place.Y, place.Z);
            transform.rotation = Quaternion.Euler(0, place.Yaw * Mathf.Rad2Deg, 0);
        }

        /// <summary>
        /// The factor to the true size, which is 1. A wish beyond what hands can hold or rooms can take is cut to that.
        /// </summary>
        public float Scale
        {
            get => transform.localScale.x;
            set
            {
                var info = Info;
                if (info != null) transform.localScale = Vector3.one * Placement.Scale(value, Floats(info.Size).Max());
            }
        }

        private async Task LookAsync(Func<Task> prepare)
        {
            var turn = _turn;
            _looking = true;
            try
            {
                await prepare();
                if (turn == _turn) await TakeAsync(turn, Info == null ? 0 : Info.Version);
            }
            finally
            {
                _looking = false;
                _nextLook = Time.unscaledTime + _pause;
            }
        }

        /// <summary>Load the version that the catalogue has now, unless it is the one at hand.</summary>
        private async Task TakeAsync(int turn, int atHand)
        {
            try
            {
                var location = await LocationAsync();
                if (turn != _turn) return;
                if (AssetLocation.Version(location) == atHand) _pause = followSeconds;
                else await LoadAsync(turn, location);
            }
            catch (CaptureFault fault)
            {
                if (turn != _turn) return;
                if (fault.Code == CaptureFault.AssetUnknown) Free(); // taken out of the collection, so out of sight
                Tell(fault);
            }
        }

        private async Task LoadAsync(int turn, IResourceLocation location)
        {
            var handle = Addressables.LoadAssetAsync<GameObject>(location);
            await handle.Task;
            if (turn != _turn) Addressables.Release(handle);
            else if (handle.Status == AsyncOperationStatus.Succeeded) Show(handle);
            else Fail(handle);
        }

        private void Show(AsyncOperationHandle<GameObject> handle)
        {
            Free();
            _handle = handle;
            _shown = Instantiate(handle.Result, transform);
            _pause = followSeconds;
            if (placeAhead && !_placed && Camera.main != null) PlaceAhead(Camera.main.transform);
            _placed = true; // a newer version comes where the old one was, wherever it has been carried
            Shown?.Invoke(this);
        }

        private void Free()
        {
            _turn++;
            if (_shown != null) Destroy(_shown);
            _shown = null;
            if (_handle.IsValid()) Addressables.Release(_handle);
            _handle = default;
        }

        private void Fail(AsyncOperationHandle<GameObject> handle)
        {
            var fault = (Exception)Catalogue.FaultOf(handle.OperationException) ?? handle.OperationException;
            Addressables.Release(handle);
            Tell(fault);
        }

        private void Tell(Exception fault)
        {
            _pause = Mathf.Min(LongestPause, 2 * _pause);
            if (Failed == null) Debug.LogError($"{key} cannot be shown: {fault}", this);
            Failed?.Invoke(fault);
        }

        private async Task<IResourceLocation> LocationAsync()
        {
            var finding = Addressables.LoadResourceLocationsAsync(AssetLocation.Prefix + key, typeof(GameObject));
            await finding.Task;
            var found = finding.Status == AsyncOperationStatus.Succeeded ? finding.Result.FirstOrDefault() : null;
            Addressables.Release(finding);
            return found ?? throw new CaptureFault(CaptureFault.AssetUnknown, $"the catalogue has no asset {key}");
        }

        private static float[] Floats(Vector3 vector) => new[] { vector.x, vector.y, vector.z };
    }
}
