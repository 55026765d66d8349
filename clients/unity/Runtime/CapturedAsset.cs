using System;
using System.Collections.Generic;
using System.Linq;
using System.Threading.Tasks;
using UnityEngine;

namespace Capture2vr
{
    /// <summary>
    /// Shows an asset by its key as a child of this object: at once in its coarsest level of detail, then in finer ones as the
    /// viewer comes near. Takes newer versions, and frees what is not seen.
    /// </summary>
    [AddComponentMenu("Capture2VR/Captured Asset")]
    public sealed class CapturedAsset : MonoBehaviour
    {
        // Seconds. The pause doubles with every failure: a damaged version would else be downloaded again and again.
        private const float LongestPause = 600;
        private const float LevelPause = 0.25f; // between two looks at the distance
        private const float FarSeconds = 5; // a level that was not wanted for so long is freed
        private const float Reluctance = 1.25f; // nor is one that a step forward would bring back

        [Tooltip("Key of the asset in its collection")]
        [SerializeField] private string key = "";

        [Tooltip("Name of the open collection; empty: the one that was opened first")]
        [SerializeField] private string collectionName = "";

        [Tooltip("Stand it on the floor ahead of the main camera once it is there")]
        [SerializeField] private bool placeAhead = true;

        [Tooltip("Give it a box to be touched and grabbed by")]
        [SerializeField] private bool boxCollider;

        [Tooltip("Seconds between looks for a newer version; 0 for none")]
        [SerializeField] private float followSeconds = 10;

        private OpenCollection _collection;
        private LodRoot _shown;
        private BoxCollider _box;
        private IReadOnlyList<GlbFile> _files = new GlbFile[0];
        private readonly HashSet<int> _missing = new HashSet<int>(); // levels that the server does not have
        private int _turn; // of showing and releasing: what comes late must see that it is not wanted any more
        private float _nextLook;
        private float _nextLevels;
        private float _farSince;
        private float _pause; // seconds between looks
        private bool _looking;
        private Task _refining = Task.CompletedTask;
        private bool _wanted; // from showing to releasing, whether it could be loaded or not
        private bool _placed;

        /// <summary>A version stands there, in its coarsest level.</summary>
        public event Action<CapturedAsset> Shown;

        /// <summary>It cannot be shown, or not as finely as it should; CaptureFault where the reason is known.</summary>
        public event Action<Exception> Failed;

        public string Key
        {
            get => key;
            set => key = value;
        }

        /// <summary>
        /// The collection that it is of: what was set, or the first open one of the name given in the inspector. Throws
        /// CaptureFault COLLECTION_CLOSED where there is none.
        /// </summary>
        public OpenCollection Collection
        {
            get => _collection ?? Named();
            set => _collection = value;
        }

        /// <summary>Whether it gets a box to be touched and grabbed by, when it is shown.</summary>
        public bool HasBoxCollider
        {
            get => boxCollider;
            set => boxCollider = value;
        }

        /// <summary>What is known of the asset, or null while none is shown.</summary>
        public CapturedInfo Info => _shown == null ? null : _shown.Root.GetComponent<CapturedInfo>();

        /// <summary>The levels of detail that are there, 0 the finest.</summary>
        public IReadOnlyList<int> Levels => _shown == null ? new int[0] : _shown.Levels;

        private async void Start()
        {
            if (key != "") await ShowAsync();
        }

        private async void Update()
        {
            var now = Time.unscaledTime;
            if (_wanted && followSeconds > 0 && !_looking && now >= _nextLook) await FollowAsync();
            if (_shown != null && now >= _nextLevels) await RefineAsync();
        }

        private void OnDestroy() => Release();

        /// <summary>
        /// Load the asset and show it, instead of what was shown; ends when its coarsest level is there. Faults go to Failed;
        /// what cannot be had now is tried again when newer versions are looked for.
        /// </summary>
        public async Task ShowAsync()
        {
            Release();
            _wanted = true;
            _pause = followSeconds;
            await LookAsync(() => Task.CompletedTask);
        }

        /// <summary>
        /// Take the newer version if there is one. The old one stands until the new one is there, and stays if that cannot
        /// be had or is refused. An asset that was removed goes, and comes again when it is restored.
        /// </summary>
        public Task FollowAsync() => LookAsync(() => Collection.UpdateAsync());

        /// <summary>Free the asset. The files stay on the device.</summary>
        public void Release()
        {
            _wanted = false;
            Hide();
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

        /// <summary>
        /// Load the next finer level where the viewer is near enough for it, and free those that have been too fine for a
        /// while. Without a main camera all levels are wanted. Faults go to Failed.
        /// </summary>
        public Task RefineAsync()
        {
            if (_refining.IsCompleted) _refining = Refine();
            return _refining;
        }

        private async Task Refine()
        {
            var turn = _turn;
            try
            {
                var levels = _files.Select(each => each.Level).Where(each => !_missing.Contains(each)).ToList();
                if (levels.Count > 0) await RefineTo(levels, ShareOfView());
            }
            catch (Exception fault)
            {
                if (turn == _turn) Tell(fault);
            }
            finally
            {
                if (turn == _turn) _nextLevels = Time.unscaledTime + Mathf.Max(LevelPause, _pause > followSeconds ? _pause : 0);
            }
        }

        private async Task RefineTo(IReadOnlyList<int> levels, float share)
        {
            var shown = _shown;
            var wanted = levels[LodChoice.Place(levels, share)];
            FreeFiner(levels[LodChoice.Place(levels, share * Reluctance)]);
            var finest = shown.Levels[0];
            if (finest <= wanted) return;
            // One step at a time: each is there four times sooner than the next.
            var next = _files.Last(each => each.Level < finest && levels.Contains(each.Level));
            try
            {
                if (await shown.AddAsync(next)) _pause = followSeconds;
            }
            catch (CaptureFault fault) when (fault.Code == CaptureFault.FileMissing || fault.Code == CaptureFault.MeshInvalid)
            {
                _missing.Add(next.Level);
                throw;
            }
        }

        private void FreeFiner(int wanted)
        {
            var tooFine = _shown.Levels.Where(each => each < wanted).ToList();
            if (tooFine.Count == 0) _farSince = Time.unscaledTime;
            if (Time.unscaledTime - _farSince < FarSeconds) return;
            foreach (var level in tooFine) _shown.Remove(level);
        }

        /// <summary>The share of the view's height that it takes, as the LODGroup counts it; more than all without a camera.</summary>
        private float ShareOfView()
        {
            var viewer = Camera.main;
            if (viewer == null) return float.PositiveInfinity;
            var box = Info.Box;
            var middle = _shown.Root.transform.TransformPoint(box.center);
            var away = Mathf.Max(1e-3f, Vector3.Distance(middle, viewer.transform.position));
            var height = Floats(box.size).Max() * transform.localScale.x;
            return height * QualitySettings.lodBias / (2 * away * Mathf.Tan(viewer.fieldOfView * Mathf.Deg2Rad / 2));
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
            catch (Exception fault)
            {
                if (turn == _turn) Tell(fault);
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
                var collection = Collection;
                var location = await collection.LocateAsync(key);
                if (turn != _turn) return;
                if (AssetLocation.Version(location) == atHand)
                {
                    _pause = followSeconds;
                    return;
                }
                location = await collection.CheckAsync(location);
                if (turn == _turn) await LoadAsync(turn, AssetLocation.Version(location), collection.Files(location));
            }
            catch (CaptureFault fault) when (fault.Code == CaptureFault.AssetUnknown || fault.Code == CaptureFault.AssetRemoved)
            {
                if (turn != _turn) return;
                Hide(); // taken out of the collection, so out of sight
                Tell(fault);
            }
        }

        /// <summary>Show the coarsest of the levels that can be had.</summary>
        private async Task LoadAsync(int turn, int version, IReadOnlyList<GlbFile> files)
        {
            var root = new LodRoot(key, version, transform);
            var missing = new HashSet<int>();
            try
            {
                var fault = await AddCoarsest(root, files, missing);
                if (turn != _turn) return;
                if (fault != null) throw fault;
                Show(root, files, missing);
                root = null;
            }
            finally
            {
                root?.Dispose();
            }
        }

        private static async Task<CaptureFault> AddCoarsest(LodRoot root, IReadOnlyList<GlbFile> files, ISet<int> missing)
        {
            CaptureFault last = null;
            foreach (var file in files.Reverse())
            {
                try
                {
                    await root.AddAsync(file);
                    return null;
                }
                catch (CaptureFault fault)
                {
                    last = fault;
                    if (fault.Code != CaptureFault.FileMissing && fault.Code != CaptureFault.FileChanged) return fault;
                    missing.Add(file.Level);
                }
            }
            return new CaptureFault(CaptureFault.FileMissing, $"{root.Root.name}: none of its files can be had; the last: {last?.Message}", "", last);
        }

        private void Show(LodRoot root, IReadOnlyList<GlbFile> files, IEnumerable<int> missing)
        {
            Free();
            _shown = root;
            _files = files;
            _missing.UnionWith(missing);
            _pause = followSeconds;
            _nextLevels = _farSince = Time.unscaledTime;
            if (placeAhead && !_placed && Camera.main != null) PlaceAhead(Camera.main.transform);
            _placed = true; // a newer version comes where the old one was, wherever it has been carried
            if (boxCollider) Enclose();
            Shown?.Invoke(this);
        }

        private void Enclose()
        {
            if (_box == null) _box = gameObject.GetComponent<BoxCollider>();
            if (_box == null) _box = gameObject.AddComponent<BoxCollider>();
            _box.center = Info.Box.center;
            _box.size = Info.Box.size;
            _box.enabled = true;
        }

        /// <summary>Free what is shown, with nothing in its place: what is not seen must not be touched either.</summary>
        private void Hide()
        {
            Free();
            if (_box != null) _box.enabled = false;
        }

        private void Free()
        {
            _turn++;
            _shown?.Dispose();
            _shown = null;
            _files = new GlbFile[0];
            _missing.Clear();
        }

        private void Tell(Exception fault)
        {
            _pause = Mathf.Min(LongestPause, 2 * Mathf.Max(LevelPause, _pause)); // 0 where nobody looks for newer versions
            if (Failed == null) Debug.LogError($"{key} cannot be shown: {fault}", this);
            Failed?.Invoke(fault);
        }

        private OpenCollection Named()
        {
            return Catalogue.Opened.FirstOrDefault(each => collectionName == "" || each.Name == collectionName)
                ?? throw new CaptureFault(CaptureFault.CollectionClosed,
                    collectionName == "" ? "no collection is open" : $"no collection {collectionName} is open", "Call Catalogue.OpenAsync first");
        }

        private static float[] Floats(Vector3 vector) => new[] { vector.x, vector.y, vector.z };
    }
}
