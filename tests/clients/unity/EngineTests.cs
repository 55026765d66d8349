// The parts that call the engine, on stubs of it: providers are found by the names in the catalogue's table, run on a
// main thread as the engine has one, and fetch from a real server.
using System;
using System.Collections.Generic;
using System.Diagnostics;
using System.IO;
using System.Linq;
using System.Reflection;
using System.Threading;
using System.Threading.Tasks;
using Capture2vr;
using GLTFast;
using UnityEngine;
using UnityEngine.AddressableAssets;
using UnityEngine.ResourceManagement.AsyncOperations;
using UnityEngine.ResourceManagement.ResourceLocations;
using UnityEngine.ResourceManagement.ResourceProviders;
using UnityEngine.XR.Interaction.Toolkit.Interactables;
using Debug = UnityEngine.Debug;
using Object = UnityEngine.Object;

public static class EngineTests
{
    private const string Bowl = "captures/bowl";

    private static string Key => Facts.All.In("key").Text();

    /// <summary>A first start on a new device, before each test.</summary>
    private static void Prepare()
    {
        Application.persistentDataPath = Facts.NewFolder();
        Engine.Start();
        Time.unscaledTime = 0;
        Camera.main = null;
        GltfImport.Fault = null;
        Debug.Errors.Clear();
        GltfImport.Alive.Clear();
        Object.Alive.Clear();
        Restart("v2");
    }

    private static void Restart(string live)
    {
        Invoke(typeof(Catalogue), null, "Forget");
        Addressables.Restart();
        Facts.Ask("turn/" + live);
    }

    private static Task<OpenCollection> Open(string way = "live", params string[] keys) => Catalogue.OpenAsync($"{Facts.Server}/{way}/", "default", keys);

    private static void Invoke(Type type, object target, string method)
    {
        type.GetMethod(method, BindingFlags.Static | BindingFlags.Instance | BindingFlags.NonPublic).Invoke(target, null);
    }

    private static async Task<AsyncOperationHandle<GameObject>> Load(string key = Bowl)
    {
        var handle = Addressables.LoadAssetAsync<GameObject>(key);
        await handle.Ended();
        return handle;
    }

    private static CapturedAsset Asset(string key = "bowl")
    {
        var asset = new GameObject("asset").AddComponent<CapturedAsset>();
        asset.Key = key;
        return asset;
    }

    /// <summary>Shown, and as fine as there is.</summary>
    private static async Task ShowAll(CapturedAsset asset)
    {
        await asset.ShowAsync();
        await RefineAll(asset);
    }

    private static async Task RefineAll(CapturedAsset asset)
    {
        for (var step = 0; step < 3 && asset.Info != null; step++) await asset.RefineAsync();
    }

    private static List<string> Codes(CapturedAsset asset)
    {
        var codes = new List<string>();
        asset.Shown += shown => Object.OnMainThread();
        asset.Failed += fault =>
        {
            Object.OnMainThread();
            codes.Add((fault as CaptureFault)?.Code ?? fault.ToString());
        };
        return codes;
    }

    private static void NothingIsLeft()
    {
        Expect.Equal(0, GltfImport.Alive.Count);
        Expect.Equal(0, Object.Alive.OfType<Mesh>().Count());
        Expect.Equal(0, Object.Alive.OfType<LODGroup>().Count());
        Expect.Equal(0, Addressables.ResourceManager.Loaded);
        foreach (var lod in Facts.All.In("lods").List())
        {
            Expect.Throws<InvalidOperationException>(() => Catalogue.Cache.Release(lod.In("sha256").Text()));
        }
    }

    // Who starts Addressables.

    public static async Task AnAppThatHasStartedAddressablesKeepsItsHandle()
    {
        var starting = Addressables.InitializeAsync(false);
        await Open();
        Expect.True(starting.IsValid(), "it is still the app's");
        Addressables.Release(starting);
        await Open("www/v1");
    }

    public static async Task ACollectionIsOpenedWhileTheAppStartsAddressables()
    {
        var starting = Addressables.InitializeAsync(); // lets go of itself
        await Open();
        Expect.True(!starting.IsValid(), "it has ended");
        Expect.Equal(AsyncOperationStatus.Succeeded, (await Load()).Status);
    }

    public static async Task AnAppWithoutSettingsOpensACollectionAfterOneThatIsNotThere()
    {
        Addressables.HasSettings = false;
        await Expect.Fault(CaptureFault.FileMissing, () => Catalogue.OpenAsync($"{Facts.Server}/www/v2", "nowhere"));
        await Open();
        Expect.Equal(AsyncOperationStatus.Succeeded, (await Load()).Status);
    }

    // The providers.

    public static async Task AnAssetIsMadeOfItsFilesAndFreedInReverse()
    {
        await Open();
        var handle = await Load();
        Addressables.Release(handle);
        var files = new[] { "/lod0", "/lod1", "/lod2" };
        var loaded = files.Select(each => $"provide {Bowl}{each}").Concat(new[] { $"provide {Bowl}", $"release {Bowl}" });
        Expect.Lines(loaded.Concat(files.Select(each => $"release {Bowl}{each}")), Addressables.ResourceManager.Log);
        NothingIsLeft();
    }

    public static async Task ThePrefabHasItsLevelsSizeAndVersion()
    {
        await Open();
        var prefab = (await Load()).Result;
        var group = prefab.GetComponent<LODGroup>();
        Expect.Lines(new[] { "0.3", "0.1", "0" }, group.GetLODs().Select(lod => lod.screenRelativeTransitionHeight.ToString()));
        Expect.Lines(new[] { "1", "1", "1" }, group.GetLODs().Select(lod => lod.renderers.Length.ToString()));
        Expect.True(Math.Abs(group.size - 1.2) < 1e-3, $"1.2 m wide, not {group.size}");
        Expect.True(Math.Abs(group.localReferencePoint.y - 0.3) < 1e-3, $"its middle is at 0.3 m, not {group.localReferencePoint.y}");
        Expect.Equal(2, prefab.GetComponent<CapturedInfo>().Version);
    }

    public static async Task ThePrefabIsHiddenAndItsClonesAreNot()
    {
        await Open();
        var prefab = (await Load()).Result;
        var clone = Object.Instantiate(prefab, new GameObject("scene").transform);
        Expect.True(prefab.activeSelf && !prefab.activeInHierarchy, "the prefab is on the shelf");
        Expect.True(clone.activeInHierarchy, "the clone is seen");
        Expect.Equal(2, clone.GetComponent<CapturedInfo>().Version);
    }

    public static async Task TwoUsersShareOnePrefabAndTheLastFreesIt()
    {
        await Open();
        var first = await Load();
        var second = await Load();
        Expect.True(first.Result == second.Result, "the same prefab");
        Addressables.Release(first);
        Expect.Equal(3, GltfImport.Alive.Count);
        Addressables.Release(second);
        NothingIsLeft();
    }

    public static async Task TheMainThreadGoesOnWhileFilesCome()
    {
        await Open("slow/v2");
        var handle = Addressables.LoadAssetAsync<GameObject>(Bowl);
        Expect.True(handle.Operation.Dependencies.All(each => each.Status == AsyncOperationStatus.None), "the call does not wait");
        var frames = 0;
        for (; !handle.IsDone; frames++) await Task.Yield();
        Expect.Equal(AsyncOperationStatus.Succeeded, handle.Status);
        Expect.True(frames > 3, $"{frames} frames went by");
    }

    public static async Task WhoWaitsOnTheMainThreadIsToldInsteadOfHanging()
    {
        await Open();
        var handle = Addressables.LoadAssetAsync<GameObject>(Bowl);
        await handle.Ended();
        Expect.Throws<NotSupportedException>(() => handle.Operation.Waiting());
        Expect.Throws<NotSupportedException>(() => handle.Operation.Dependencies[0].Waiting());
    }

    public static async Task DownloadProgressIsThatOfTheFiles()
    {
        await Open();
        var handle = await Load();
        var status = handle.Operation.Dependencies[0].Downloading();
        Expect.Equal(Facts.All.In("lods").List()[0].In("bytes").Whole(), status.TotalBytes);
        Expect.Equal(1f, status.Percent);
        Expect.True(status.IsDone, "it is done");
    }

    public static async Task AMissingFileLeavesTheOtherLevels()
    {
        await Open("www/partly");
        var handle = await Load();
        Expect.Equal(2, handle.Result.GetComponent<LODGroup>().GetLODs().Length);
        Expect.Equal(2, GltfImport.Alive.Count);
        Addressables.Release(handle);
        NothingIsLeft();
    }

    public static async Task WhatIsDownloadedInAdvanceIsThereWithoutANetwork()
    {
        await Open();
        var downloading = Addressables.DownloadDependenciesAsync(Bowl);
        Expect.Equal(3, (await downloading.Ended()).Count);
        Facts.Ask("turn/off");
        var handle = await Load();
        Expect.Equal(3, handle.Result.GetComponent<LODGroup>().GetLODs().Length);
        Addressables.Release(handle);
        Addressables.Release(downloading);
        NothingIsLeft();
    }

    public static async Task FilesThatWereChangedOnTheWayAreNotShown()
    {
        await Open("www/spoilt");
        var file = Addressables.LoadAssetAsync<IAssetBundleResource>(Bowl + "/lod0");
        await file.Ended();
        Expect.Equal(CaptureFault.FileChanged, Catalogue.FaultOf(file.OperationException).Code);
        var handle = await Load();
        Expect.Equal(CaptureFault.FileMissing, Catalogue.FaultOf(handle.OperationException).Code);
        Addressables.Release(file);
        Addressables.Release(handle);
        NothingIsLeft();
    }

    public static async Task AFileThatIsNoMeshFailsWithWhatGltfastSaysAndFreesEverything()
    {
        await Open();
        GltfImport.Fault = "extension EXT_meshopt_compression is not supported";
        var handle = await Load();
        var fault = Catalogue.FaultOf(handle.OperationException);
        Expect.Equal(CaptureFault.MeshInvalid, fault.Code);
        Expect.True(fault.Message.Contains(GltfImport.Fault), fault.Message);
        Addressables.Release(handle);
        NothingIsLeft();
        GltfImport.Fault = null;
        Expect.Equal(AsyncOperationStatus.Succeeded, (await Load()).Status);
    }

    public static async Task AFileThatWasDamagedOnTheDeviceIsFetchedAgain()
    {
        await Open();
        var file = Addressables.LoadAssetAsync<IAssetBundleResource>(Bowl + "/lod0");
        var path = ((GlbFileResource)await file.Ended()).Path;
        Addressables.Release(file);
        File.WriteAllText(path, "no mesh at all, but longer than a header");
        Expect.Equal(AsyncOperationStatus.Succeeded, (await Load()).Status);
    }

    public static async Task ALocationWhoseHashesDisagreeIsRefused()
    {
        await Open();
        var told = (await Location(Bowl)).Dependencies[0];
        var options = (AssetBundleRequestOptions)told.Data;
        var datas = new object[] { null, "text", Options(new string('0', 32), options), Options("", options) };
        foreach (var data in datas) await Refused(told.InternalId, data);
        await Refused(told.InternalId.Replace(".glb", ".glb.x"), options); // in no open collection
    }

    private static AssetBundleRequestOptions Options(string hash, AssetBundleRequestOptions options)
    {
        return new AssetBundleRequestOptions { Hash = hash, BundleName = options.BundleName, BundleSize = options.BundleSize };
    }

    private static async Task Refused(string id, object data)
    {
        var location = new ResourceLocationBase(Bowl + "/lod0", id, "Capture2vr.GlbFileProvider", typeof(IAssetBundleResource)) { Data = data };
        var handle = Addressables.LoadAssetAsync<IAssetBundleResource>(location);
        await handle.Ended();
        Expect.Equal(CaptureFault.LocationInvalid, Catalogue.FaultOf(handle.OperationException).Code);
        Addressables.Release(handle);
    }

    private static async Task<IResourceLocation> Location(string key)
    {
        return (await Addressables.LoadResourceLocationsAsync(key).Ended()).Single();
    }

    // The signed catalogue beside the unsigned one.

    public static async Task WithKeysASignedAssetLoads()
    {
        await Open("live", Key);
        Expect.Equal(AsyncOperationStatus.Succeeded, (await Load()).Status);
    }

    public static async Task WithKeysAForgedUnityCatalogueShowsNothing()
    {
        await Open("www/forged", Key);
        var handle = await Load();
        Expect.Equal(CaptureFault.FileNotSigned, Catalogue.FaultOf(handle.OperationException).Code);
        Addressables.Release(handle);
        NothingIsLeft();
        Restart("v2"); // the forged version 3 does not count as seen
        await Open("live", Key);
        Expect.Equal(2, (await Load()).Result.GetComponent<CapturedInfo>().Version);
    }

    public static async Task WithKeysAVersionThatNobodySignedDoesNotCountAsSeen()
    {
        Restart("inflated");
        await Open("live", Key);
        var asset = Asset();
        var codes = Codes(asset);
        await asset.ShowAsync();
        Expect.Lines(new[] { CaptureFault.FileNotSigned }, codes);
        Restart("v2");
        await Open("live", Key);
        await asset.ShowAsync();
        Expect.Equal(2, asset.Info.Version);
        asset.Release();
    }

    // The component.

    public static async Task TheComponentShowsPlacesAndFreesAnAsset()
    {
        Camera.main = new GameObject("camera").AddComponent<Camera>();
        Camera.main.transform.position = new Vector3(1, 1.6f, 0);
        Camera.main.transform.forward = new Vector3(1, 0, 0);
        await Open();
        var asset = Asset();
        Invoke(typeof(CapturedAsset), asset, "Start");
        await Expect.Comes(() => asset.Info != null);
        var place = asset.transform.position;
        Expect.Near(2.5, place.x);
        Expect.True(Math.Abs(place.y - (1.2 - 0.3)) < 1e-3, $"a bowl of 0.6 m stands at {place.y}");
        Expect.Near(-90, asset.transform.rotation.eulerAngles.y);
        Expect.Equal(1, asset.transform.childCount);
        Expect.True(asset.gameObject.GetComponent<BoxCollider>() == null, "nobody asked for a collider");
        Invoke(typeof(CapturedAsset), asset, "OnDestroy");
        NothingIsLeft();
    }

    public static async Task ItsScaleHasLimits()
    {
        await Open();
        var asset = Asset();
        await asset.ShowAsync();
        asset.Scale = 2;
        Expect.Near(2, asset.Scale);
        asset.Scale = 1e6f;
        Expect.True(Math.Abs(asset.Scale - 20 / 1.2) < 0.05, $"it may be 20 m long, not {asset.Scale} times itself");
    }

    public static async Task ANewVersionComesWhereTheOldOneStands()
    {
        Restart("v1");
        await Open();
        CapturedAsset one = Asset(), two = Asset();
        await Task.WhenAll(ShowAll(one), ShowAll(two));
        one.transform.position = new Vector3(7, 0, 0);
        Expect.Equal(1, one.Info.Version);
        await one.FollowAsync();
        Expect.Equal(1, one.Info.Version);
        Facts.Ask("turn/v2");
        Time.unscaledTime = 60;
        Invoke(typeof(CapturedAsset), one, "Update");
        await Expect.Comes(() => one.Info.Version == 2);
        Expect.Equal(1, two.Info.Version);
        await two.FollowAsync();
        Expect.Equal(2, two.Info.Version);
        Expect.Near(7, one.transform.position.x);
        await Task.WhenAll(RefineAll(one), RefineAll(two));
        Expect.Equal(3, GltfImport.Alive.Count); // both share the new version, and nothing of the old one is left
        foreach (var each in new[] { one, two }) each.Release();
        NothingIsLeft();
    }

    public static async Task TheKeyGivesTheNewVersionWhileTheOldOneIsHeld()
    {
        Restart("v1");
        await Open();
        var old = await Load();
        var before = await Location(Bowl);
        Facts.Ask("turn/v2");
        await Catalogue.UpdateAsync();
        var fresh = await Load();
        Expect.Equal(1, old.Result.GetComponent<CapturedInfo>().Version);
        Expect.Equal(2, fresh.Result.GetComponent<CapturedInfo>().Version);
        Expect.Lines(new[] { Bowl + "@1", Bowl + "@2" }, new[] { before.InternalId, (await Location(Bowl)).InternalId });
        Expect.Equal(before.PrimaryKey, (await Location(Bowl)).PrimaryKey);
        Addressables.Release(old);
        Addressables.Release(fresh);
        NothingIsLeft();
    }

    public static async Task WhatIsShownStaysWhenTheNewVersionIsDamaged()
    {
        await Open();
        var asset = Asset();
        var codes = Codes(asset);
        await asset.ShowAsync();
        Facts.Ask("turn/spoilt");
        await asset.FollowAsync();
        Expect.Equal(2, asset.Info.Version);
        Expect.Lines(new[] { CaptureFault.FileMissing }, codes);
        asset.Release();
        NothingIsLeft();
    }

    public static async Task ADamagedVersionIsAskedForLessAndLessOften()
    {
        await Open();
        var asset = Asset();
        var codes = Codes(asset);
        await asset.ShowAsync();
        Facts.Ask("turn/spoilt");
        for (var second = 0; second <= 80; second += 5)
        {
            Time.unscaledTime = second;
            Invoke(typeof(CapturedAsset), asset, "Update");
            await Expect.Comes(() => !(bool)Field(asset, "_looking"));
            await Task.Yield();
        }
        Expect.Equal(3, codes.Count); // after 10, 30 and 70 seconds
        asset.Release();
    }

    private static object Field(CapturedAsset asset, string name)
    {
        return typeof(CapturedAsset).GetField(name, BindingFlags.Instance | BindingFlags.NonPublic).GetValue(asset);
    }

    public static async Task ARolledBackVersionIsRefused()
    {
        await Open();
        var asset = Asset();
        var codes = Codes(asset);
        await asset.ShowAsync();
        Facts.Ask("turn/v1");
        await asset.FollowAsync();
        Expect.Equal(2, asset.Info.Version);
        Expect.Lines(new[] { CaptureFault.CatalogueOlder }, codes);
        asset.Release();
        Restart("v1");
        await Open();
        await asset.ShowAsync();
        Expect.Lines(new[] { CaptureFault.CatalogueOlder, CaptureFault.CatalogueOlder }, codes);
        Expect.True(asset.Info == null, "nothing is shown");
        NothingIsLeft();
    }

    public static async Task WhatIsRemovedFromTheCollectionGoes()
    {
        await Open();
        var asset = Asset();
        var codes = Codes(asset);
        await asset.ShowAsync();
        Facts.Ask("turn/removed");
        await asset.FollowAsync();
        Expect.True(asset.Info == null, "it is out of sight");
        Expect.Lines(new[] { CaptureFault.AssetRemoved }, codes);
        NothingIsLeft();
        Facts.Ask("turn/v2");
        await asset.FollowAsync();
        Expect.Equal(2, asset.Info.Version);
        asset.Release();
    }

    public static async Task WhatCouldNotBeHadComesLater()
    {
        await Open();
        Facts.Ask("turn/off");
        var asset = Asset();
        var codes = Codes(asset);
        await asset.ShowAsync();
        Expect.Lines(new[] { CaptureFault.Unreachable }, codes);
        Facts.Ask("turn/v2");
        Time.unscaledTime = 60;
        Invoke(typeof(CapturedAsset), asset, "Update");
        await Expect.Comes(() => asset.Info != null);
        await RefineAll(asset);
        asset.Release();
        Time.unscaledTime = 120;
        Invoke(typeof(CapturedAsset), asset, "Update");
        Expect.True(!(bool)Field(asset, "_looking"), "nobody wants it any more");
        NothingIsLeft();
    }

    public static async Task WithoutANetworkWhatTheDeviceHasIsShown()
    {
        await Open("live", Key);
        var asset = Asset();
        await asset.ShowAsync();
        asset.Release();
        Facts.Ask("turn/off");
        await asset.ShowAsync();
        Expect.Equal(2, asset.Info.Version);
        await asset.FollowAsync();
        Expect.Equal(2, asset.Info.Version);
        asset.Release();
        NothingIsLeft();
    }

    public static async Task ADeviceThatCannotNoteTheVersionShowsTheAssetAllTheSame()
    {
        await Open("live", Key);
        foreach (var folder in Directory.GetDirectories(Path.Combine(Application.persistentDataPath, "capture2vr"), "collection-*"))
        {
            Directory.CreateDirectory(Path.Combine(folder, "versions.txt.part")); // no file can be written there
        }
        var asset = Asset();
        var codes = Codes(asset);
        await asset.ShowAsync();
        Expect.Lines(new string[0], codes);
        Expect.Equal(2, asset.Info.Version);
        Facts.Ask("turn/v1");
        await asset.FollowAsync();
        Expect.Lines(new[] { CaptureFault.CatalogueOlder }, codes);
        asset.Release();
    }

    public static async Task PrivateAssetsAreShownWithHeadersThatAreRenewed()
    {
        await Expect.Fault(CaptureFault.AccessRefused, () => Open("keyed"));
        Catalogue.AccessTo($"{Facts.Server}/keyed").Renewal = () => Task.FromResult<IReadOnlyDictionary<string, string>>(
            new Dictionary<string, string> { { "Authorization", "Bearer good" } });
        await Open("keyed", Key);
        Expect.Equal(1, Catalogue.AccessTo($"{Facts.Server}/keyed/").Current.Count);
        Expect.Equal(0, Catalogue.AccessTo($"{Facts.Server}/live").Current.Count);
        var asset = Asset();
        await asset.ShowAsync();
        Expect.Equal(2, asset.Info.Version);
        asset.Release();
        NothingIsLeft();
    }

    public static async Task TheAppsOwnRequestsOfAddressablesStayAsTheyWere()
    {
        var own = 0;
        Addressables.WebRequestOverride = request => own++;
        await Open();
        await Open("www/v1");
        Expect.True(own >= 2, "what the app does to requests is done");
        Addressables.WebRequestOverride = null;
    }

    public static async Task WhatTheAppsOwnRenewalThrowsIsToldAsAFault()
    {
        await Open("live");
        var asset = Asset();
        var faults = new List<Exception>();
        asset.Failed += faults.Add;
        Catalogue.AccessTo($"{Facts.Server}/keyed").Current = new Dictionary<string, string> { { "Authorization", "Bearer good" } };
        var keyed = await Open("keyed");
        var access = Catalogue.AccessTo($"{Facts.Server}/keyed");
        access.Current = null;
        access.Renewal = () => throw new InvalidOperationException("the login server is down");
        asset.Collection = keyed;
        await asset.ShowAsync();
        Expect.Lines(new[] { "the login server is down" }, faults.Select(each => each.Message));
        asset.Release();
        NothingIsLeft();
    }

    public static async Task AnUnknownKeyAndACatalogueOutOfReachAreNamed()
    {
        await Open();
        var asset = Asset("nobody");
        var codes = Codes(asset);
        await asset.ShowAsync();
        Expect.Lines(new[] { CaptureFault.AssetUnknown }, codes);
        Restart("off");
        Application.persistentDataPath = Facts.NewFolder();
        var fault = await Expect.Fault(CaptureFault.Unreachable, () => Open());
        Expect.True(fault.Message.Contains("default"), fault.Message);
    }

    public static async Task WithNobodyListeningTheReasonIsLogged()
    {
        await Open();
        await Asset("nobody").ShowAsync();
        Expect.True(Debug.Errors.Single().Contains("nobody"), "the log names the asset");
    }

    public static async Task WhatIsReleasedWhileItLoadsLeavesNothing()
    {
        await Open("slow/v2");
        var asset = Asset();
        var showing = asset.ShowAsync();
        await Expect.Comes(() => GltfImport.Alive.Count > 0);
        asset.Release();
        await showing;
        await Expect.Comes(() => GltfImport.Alive.Count == 0);
        Expect.True(asset.Info == null, "nothing is shown");
        NothingIsLeft();
    }

    public static async Task WhatIsReleasedWhileALevelIsDecodedStandsNowhere()
    {
        await Open();
        var asset = Asset();
        var before = Object.Alive.OfType<GameObject>().Count();
        await asset.ShowAsync();
        var refining = asset.RefineAsync();
        await Expect.Comes(() => GltfImport.Alive.Count > 1);
        asset.Release();
        await refining;
        await Expect.Comes(() => GltfImport.Alive.Count == 0);
        Expect.Equal(before, Object.Alive.OfType<GameObject>().Count());
        NothingIsLeft();
    }

    public static async Task TheLastOfTwoCallsCounts()
    {
        await Open("slow/v2");
        var asset = Asset();
        var first = asset.ShowAsync();
        asset.Key = "cup";
        await Task.WhenAll(first, asset.ShowAsync());
        Expect.Equal(1, asset.Info.Version);
        Expect.Equal(1, asset.transform.childCount);
        asset.Release();
        NothingIsLeft();
    }

    // Levels of detail of the component.

    public static async Task TheCoarsestLevelIsShownFirstAndFinerOnesOnApproach()
    {
        Camera.main = new GameObject("camera").AddComponent<Camera>();
        Camera.main.transform.position = new Vector3(0, 0.3f, -30);
        await Open();
        var asset = Asset();
        var levels = new List<string>();
        asset.Shown += shown => levels.Add(string.Join(" ", shown.Levels));
        await asset.ShowAsync();
        Expect.Lines(new[] { "2" }, levels);
        asset.transform.position = new Vector3(0, 0, 0);
        foreach (var away in new[] { 30f, 4f, 1.5f })
        {
            Camera.main.transform.position = new Vector3(0, 0.3f, -away);
            await RefineAll(asset);
            levels.Add(string.Join(" ", asset.Levels));
        }
        Expect.Lines(new[] { "2", "2", "1 2", "0 1 2" }, levels);
        Expect.Equal(3, asset.transform.GetChild(0).gameObject.GetComponent<LODGroup>().GetLODs().Length);
        asset.Release();
        NothingIsLeft();
    }

    public static async Task FineLevelsAreFreedSomeSecondsAfterTheViewerHasGone()
    {
        Camera.main = new GameObject("camera").AddComponent<Camera>();
        Camera.main.transform.position = new Vector3(0, 0.3f, -1);
        await Open();
        CapturedAsset near = Asset(), other = Asset();
        foreach (var each in new[] { near, other }) await ShowAll(each);
        foreach (var each in new[] { near, other }) Expect.Lines(new[] { "0", "1", "2" }, each.Levels.Select(level => level.ToString()));
        Expect.Equal(3, GltfImport.Alive.Count);
        near.transform.position = new Vector3(0, 0, 100);
        await near.RefineAsync();
        Expect.Equal(3, near.Levels.Count); // the viewer may come back
        Time.unscaledTime = 4;
        await near.RefineAsync();
        Expect.Equal(3, near.Levels.Count);
        Time.unscaledTime = 6;
        await near.RefineAsync();
        Expect.Equal("2", string.Join(" ", near.Levels));
        Expect.Equal(3, GltfImport.Alive.Count); // the other one uses them
        other.Release();
        Expect.Equal(1, GltfImport.Alive.Count);
        near.Release();
        NothingIsLeft();
    }

    public static async Task ALevelThatIsMissingIsToldOnceAndDoneWithout()
    {
        await Open("www/partly");
        var asset = Asset();
        var codes = Codes(asset);
        await ShowAll(asset);
        await RefineAll(asset);
        Expect.Equal("1 2", string.Join(" ", asset.Levels));
        Expect.Lines(new[] { CaptureFault.FileMissing }, codes);
        asset.Release();
        NothingIsLeft();
    }

    public static async Task ADamagedLevelIsAskedForLessAndLessOftenAlsoWhereNobodyLooksForNewerVersions()
    {
        await Open("www/flawed");
        var asset = Asset();
        var codes = Codes(asset);
        typeof(CapturedAsset).GetField("followSeconds", BindingFlags.Instance | BindingFlags.NonPublic).SetValue(asset, 0f);
        await asset.ShowAsync();
        for (var step = 0; step < 120; step++)
        {
            Time.unscaledTime += 0.25f;
            Invoke(typeof(CapturedAsset), asset, "Update");
            await Expect.Comes(() => ((Task)Field(asset, "_refining")).IsCompleted);
            await Task.Yield();
        }
        Expect.True(codes.All(each => each == CaptureFault.FileChanged), string.Join(" ", codes));
        Expect.True(codes.Count > 1 && codes.Count < 10, $"{codes.Count} times in half a minute");
        asset.Release();
    }

    public static async Task ItMayHaveABoxToBeGrabbedBy()
    {
        await Open();
        var asset = Asset();
        asset.HasBoxCollider = true;
        await asset.ShowAsync();
        var box = asset.gameObject.GetComponent<BoxCollider>();
        Expect.True(Math.Abs(box.size.x - 1.2) < 0.02 && Math.Abs(box.center.y - 0.3) < 0.02, $"{box.size.x}, {box.center.y}");
        asset.Release();
    }

    public static async Task WhatIsGoneCannotBeTouched()
    {
        await Open();
        var asset = Asset();
        asset.HasBoxCollider = true;
        await asset.ShowAsync();
        var box = asset.gameObject.GetComponent<BoxCollider>();
        Expect.True(box.enabled, "it can be touched");
        Facts.Ask("turn/removed");
        await asset.FollowAsync();
        Expect.True(!box.enabled, "it was removed");
        Facts.Ask("turn/v2");
        await asset.FollowAsync();
        Expect.True(box.enabled && box == asset.gameObject.GetComponent<BoxCollider>(), "it is there again");
        asset.Release();
        Expect.True(!box.enabled, "it was released");
    }

    // Several collections, and what of them is on the device.

    public static async Task TwoServersMayHaveTheSameKeys()
    {
        var first = await Open("www/v1", Key);
        var second = await Open("www/v2");
        CapturedAsset old = Asset(), fresh = Asset();
        fresh.Collection = second;
        Expect.True(old.Collection == first, "the first one is meant where nothing is said");
        foreach (var each in new[] { old, fresh }) await ShowAll(each);
        Expect.Equal(1, old.Info.Version);
        Expect.Equal(2, fresh.Info.Version);
        // By the key alone the first one counts, which asks for signatures still.
        Expect.Equal(1, (await Load()).Result.GetComponent<CapturedInfo>().Version);
        foreach (var each in new[] { old, fresh }) each.Release();
    }

    public static async Task EachCollectionAsksForItsOwnSignatures()
    {
        await Open("live");
        var forged = await Open("www/forged", Key);
        var asset = Asset();
        asset.Collection = forged;
        var codes = Codes(asset);
        await asset.ShowAsync();
        Expect.Lines(new[] { CaptureFault.FileNotSigned }, codes);
    }

    public static async Task OpeningAgainIsALookForNewerVersionsAndDropsNoKey()
    {
        Restart("forged");
        var first = await Open("live", Key);
        Facts.Ask("turn/v2");
        var again = await Open("live");
        Expect.True(first == again && Catalogue.Opened.Count == 1, "one collection");
        Expect.Equal(1, Addressables.Updated.Count);
        Expect.Equal(2, (await Load()).Result.GetComponent<CapturedInfo>().Version);
        Facts.Ask("turn/forged");
        await Open("live");
        var handle = await Load();
        Expect.Equal(CaptureFault.FileNotSigned, Catalogue.FaultOf(handle.OperationException).Code);
    }

    public static async Task AKeyThatIsNoneIsNamedAndSpoilsNothing()
    {
        await Open("live", Key);
        foreach (var each in new[] { "no base64!", "AAAA" })
        {
            var told = "";
            try
            {
                await Open("live", each);
            }
            catch (ArgumentException fault)
            {
                told = fault.Message;
            }
            Expect.True(told.Contains($"\"{each}\" is no public key"), told);
            await Open("live", Key);
        }
    }

    public static async Task OpeningTwiceAtOnceIsOneCollectionWithTheKeysOfBoth()
    {
        Restart("forged");
        var both = await Task.WhenAll(Open("live"), Open("live", Key));
        Expect.True(both[0] == both[1] && Catalogue.Opened.Count == 1, "one collection");
        var asset = Asset();
        var codes = Codes(asset);
        await asset.ShowAsync();
        Expect.Lines(new[] { CaptureFault.FileNotSigned }, codes);
    }

    public static async Task OnlyItsOwnCatalogueIsUpdatedAndOnlyWhenItHasChanged()
    {
        Restart("v1");
        var live = await Open();
        var other = await Open("www/v1");
        await Catalogue.UpdateAsync();
        Expect.Equal(0, Addressables.Updated.Count);
        Facts.Ask("turn/v2");
        await Catalogue.UpdateAsync();
        Expect.Lines(new[] { $"{live.BaseUrl}/collections/default/unity/{Catalogue.FileName}" }, Addressables.Updated);
        Expect.True(other.BaseUrl != live.BaseUrl, "the other one stays as it is");
    }

    public static async Task AnAssetIsDownloadedAheadCountedAndCleared()
    {
        var collection = await Open("live", Key);
        Expect.Lines(new[] { "bowl", "cup" }, collection.Keys);
        Expect.Equal(0, collection.WithLabel("nothing").Count);
        var bytes = Facts.All.In("lods").List().Sum(lod => lod.In("bytes").Whole());
        Expect.Equal(bytes, collection.RemainingBytes("bowl"));
        var told = new Told();
        await collection.DownloadAsync("bowl", told);
        Expect.Equal(1f, told.Shares.Last());
        Expect.True(collection.IsCached("bowl") && !collection.IsCached("cup"), "one of two is here");
        Facts.Ask("turn/off");
        var asset = Asset();
        await ShowAll(asset);
        Expect.Equal(3, asset.Levels.Count);
        asset.Release();
        Expect.Equal(bytes, collection.Clear("bowl"));
        Expect.Equal(bytes, collection.RemainingBytes("bowl"));
        await Expect.Fault(CaptureFault.Unreachable, () => collection.DownloadAsync("bowl"));
        await Expect.Fault(CaptureFault.AssetUnknown, () => collection.DownloadAsync("nobody"));
        NothingIsLeft();
    }

    // Collections that are too large for a catalogue of Addressables.

    private static long Large => Facts.All.In("large").Whole();

    private static async Task<OpenCollection> OpenLarge(params string[] keys)
    {
        Restart("large1");
        return await Open("live", keys);
    }

    private static async Task<IList<IResourceLocation>> Locations(string key) => await Addressables.LoadResourceLocationsAsync(key).Ended();

    public static async Task LocationsAreThoseThatTheServersCatalogueHas()
    {
        Restart("large2");
        var collection = await Open("live", Key);
        await collection.EnsureAsync(Facts.All.In("listed").List().Select(each => each.Text()).ToArray());
        var table = Json.Parse(Facts.Ask("www/large2/listed.json"));
        var wanted = table.In("locations").List();
        Expect.True(wanted.Count > 600, "files and assets");
        foreach (var each in wanted)
        {
            var found = (await Locations(each.In("key").Text())).Single();
            Expect.Equal(Described(each, wanted), Described(found));
        }
        var locator = Addressables.ResourceLocators.Single();
        Expect.Lines(wanted.Select(each => each.In("key").Text()).OrderBy(each => each), locator.Keys.Cast<string>().OrderBy(each => each));
        Expect.Equal(wanted.Count, locator.AllLocations.Count());
    }

    /// <summary>All that our writer tells of a location.</summary>
    private static string Described(object told, List<object> all)
    {
        var data = told.In("data");
        var options = data as string ?? $"{data.In("hash").Text()} {data.In("crc").Whole()} {data.In("name").Text()} {data.In("size").Whole()}";
        var dependencies = told.In("dependencies").List().Select(place => all[(int)place.Whole()].In("key").Text());
        var id = told.In("internal_id").Text().Replace("{Capture2vr.Catalogue.BaseUrl}", Catalogue.BaseUrl);
        return string.Join(" | ", told.In("key").Text(), id, told.In("provider").Text(), told.In("type").In("name").Text(), options, string.Join(" ", dependencies));
    }

    private static string Described(IResourceLocation location)
    {
        var bundle = location.Data as AssetBundleRequestOptions;
        var options = bundle == null ? (string)location.Data : $"{bundle.Hash} {bundle.Crc} {bundle.BundleName} {bundle.BundleSize}";
        var dependencies = string.Join(" ", location.Dependencies.Select(each => each.PrimaryKey));
        return string.Join(" | ", location.PrimaryKey, location.InternalId, location.ProviderId, location.ResourceType.FullName, options, dependencies);
    }

    public static async Task OfALargeCollectionAddressablesLoadsWhatWasFound()
    {
        var collection = await OpenLarge(Key);
        Expect.Equal(0, (await Locations(Bowl)).Count);
        await collection.EnsureAsync("bowl", "cup");
        var handle = await Load();
        Expect.Equal(1, handle.Result.GetComponent<CapturedInfo>().Version);
        var downloading = Addressables.DownloadDependenciesAsync("captures/cup");
        Expect.Equal(3, (await downloading.Ended()).Count);
        Addressables.Release(downloading);
        Addressables.Release(handle);
        NothingIsLeft();
        await Expect.Fault(CaptureFault.AssetUnknown, () => collection.EnsureAsync("nobody"));
    }

    public static async Task ALargeCollectionIsSearchedInsteadOfListed()
    {
        var collection = await OpenLarge(Key);
        Expect.Equal(CaptureFault.CollectionLarge, Expect.Throws<CaptureFault>(() => collection.Keys.ToString()).Code);
        var fault = Expect.Throws<CaptureFault>(() => collection.WithLabel("kitchen"));
        Expect.True(fault.Message.Contains($"{Large:N0}") && fault.Message.Contains("WithLabelAsync"), fault.Message);
        Expect.Lines(new[] { "bowl", "cup" }, await collection.WithLabelAsync("kitchen"));
        Expect.Equal(100, (await collection.WithLabelAsync("rare")).Count);
        Expect.Equal(Large, (long)(await collection.KeysAsync()).Count);
        Expect.Equal(Large, (long)(await collection.RowsAsync()).Count);
        Expect.True(Expect.Throws<CaptureFault>(() => collection.IsCached("bowl")).Message.Contains("EnsureAsync"), "it says what to do");
        await collection.DownloadAsync("bowl");
        Expect.True(collection.IsCached("bowl") && collection.Clear("bowl") > 0, "it is found by then");
    }

    public static async Task TheComponentShowsAndFollowsAnAssetOfALargeCollection()
    {
        await OpenLarge(Key);
        var asset = Asset();
        var codes = Codes(asset);
        await asset.ShowAsync();
        Expect.Equal(1, asset.Info.Version);
        await asset.FollowAsync();
        Facts.Ask("turn/large2");
        await asset.FollowAsync();
        Expect.Equal(2, asset.Info.Version);
        Facts.Ask("turn/large1");
        await asset.FollowAsync(); // a root of before is refused, and what is shown stays
        Expect.Equal(2, asset.Info.Version);
        Expect.Lines(new string[0], codes);
        asset.Release();
        NothingIsLeft();
    }

    public static async Task OfALargeCollectionTooTheKeyGivesTheNewVersionWhileTheOldOneIsHeld()
    {
        var collection = await OpenLarge();
        await collection.EnsureAsync("bowl", "asset-00100");
        var before = await Location(Bowl);
        Facts.Ask("turn/large2");
        await Catalogue.UpdateAsync();
        var old = Addressables.LoadAssetAsync<GameObject>(before);
        await old.Ended();
        Expect.Equal(1, old.Result.GetComponent<CapturedInfo>().Version);
        var fresh = await Load();
        Expect.Equal(2, fresh.Result.GetComponent<CapturedInfo>().Version);
        Expect.Lines(new[] { Bowl + "@1", Bowl + "@2" }, new[] { before.InternalId, (await Location(Bowl)).InternalId });
        Expect.Equal(0, (await Locations("captures/asset-00100")).Count);
        await Expect.Fault(CaptureFault.AssetRemoved, () => collection.EnsureAsync("asset-00100"));
        Addressables.Release(old);
        Addressables.Release(fresh);
        NothingIsLeft();
    }

    public static async Task WhatWasFoundOfALargeCollectionIsThereWithoutANetwork()
    {
        await (await OpenLarge(Key)).DownloadAsync("bowl");
        Restart("off");
        await Open("live", Key);
        var asset = Asset();
        await asset.ShowAsync();
        Expect.Equal(1, asset.Info.Version);
        asset.Release();
        NothingIsLeft();
    }

    public static async Task KeysThatAreGivenLaterCountForWhatWasFoundBefore()
    {
        await (await OpenLarge()).EnsureAsync("bowl");
        await Open("live", Convert.ToBase64String(new byte[32]));
        var handle = await Load(); // nobody whom the app believes has signed it
        Expect.Equal(CaptureFault.KeyUnknown, Catalogue.FaultOf(handle.OperationException).Code);
        Addressables.Release(handle);
        await Open("live", Key);
        Expect.Equal(AsyncOperationStatus.Succeeded, (await Load()).Status);
    }

    public static async Task ACollectionThatGrowsTooLargeGoesOn()
    {
        var collection = await Open("live", Key);
        var asset = Asset();
        var codes = Codes(asset);
        await asset.ShowAsync();
        Facts.Ask("turn/large2");
        await asset.FollowAsync();
        Expect.Equal(2, asset.Info.Version);
        Expect.Lines(new string[0], codes);
        Expect.Equal(CaptureFault.CollectionLarge, Expect.Throws<CaptureFault>(() => collection.Keys.ToString()).Code);
        Expect.Equal(AsyncOperationStatus.Succeeded, (await Load("captures/cup")).Status); // of the catalogue that there was
        await collection.EnsureAsync("asset-00001");
        await collection.DownloadAsync("cup");
        Restart("off"); // Addressables would give its old catalogue from now on
        var again = await Open("live", Key);
        Expect.Equal(CaptureFault.CollectionLarge, Expect.Throws<CaptureFault>(() => again.Keys.ToString()).Code);
        await again.EnsureAsync("asset-00001");
    }

    public static async Task TenThousandAssetsAreFoundSearchedAndUpdatedInThisTime()
    {
        Restart("large1");
        var watch = Stopwatch.StartNew();
        Action<string> lap = what =>
        {
            Console.WriteLine($"seconds {watch.Elapsed.TotalSeconds:0.00} {what}");
            watch.Restart();
        };
        var collection = await Open("live", Key);
        lap("to open");
        var handle = await Load(await Found(collection, "bowl"));
        lap("to find one and load it");
        await collection.EnsureAsync("cup");
        lap("to find one more");
        await collection.EnsureAsync(Facts.All.In("listed").List().Select(each => each.Text()).ToArray());
        lap("to find 300 in one call");
        Expect.Equal(100, (await collection.WithLabelAsync("rare")).Count);
        lap("to find 100 by a label, on a first visit");
        Expect.Equal(100, (await collection.WithLabelAsync("rare")).Count);
        lap("to find them again");
        await Catalogue.UpdateAsync();
        lap("to see that nothing is new");
        Facts.Ask("turn/large2");
        await Catalogue.UpdateAsync();
        lap("to take the new version of two of 302 that are known");
        Expect.Equal(2, AssetVersion(await Locations(Bowl)));
        Addressables.Release(handle);
        NothingIsLeft();
    }

    private static async Task<string> Found(OpenCollection collection, string key)
    {
        await collection.EnsureAsync(key);
        return "captures/" + key;
    }

    // Unity catalogues that are behind the signed one.

    public static async Task WhatTheUnityCatalogueHasOfBeforeIsShownAsItIsNow()
    {
        Restart("behind");
        var collection = await Open("live", Key);
        var asset = Asset();
        var codes = Codes(asset);
        var handle = await Load(); // Addressables alone, before anything was found
        Expect.Equal(2, handle.Result.GetComponent<CapturedInfo>().Version);
        await asset.ShowAsync();
        await asset.FollowAsync();
        Expect.Equal(2, asset.Info.Version);
        await collection.DownloadAsync("bowl");
        Expect.True(collection.IsCached("bowl"), "as it is now");
        Expect.Equal(2, AssetVersion(await Locations(Bowl)));
        Facts.Ask("turn/v2");
        await asset.FollowAsync();
        Expect.Equal(2, asset.Info.Version);
        Expect.Equal(1, (await Locations(Bowl)).Count); // Unity's again, alone
        Expect.Lines(new string[0], codes);
        Expect.Lines(new[] { "bowl", "cup" }, collection.Keys);
        asset.Release();
        Addressables.Release(handle);
        NothingIsLeft();
    }

    /// <summary>That of the location which Addressables takes.</summary>
    private static int AssetVersion(IList<IResourceLocation> locations) => int.Parse(locations[0].InternalId.Split('@')[1]);

    public static async Task WhatTheUnityCatalogueDoesNotHaveYetIsFound()
    {
        foreach (var keys in new[] { new string[0], new[] { Key } })
        {
            Application.persistentDataPath = Facts.NewFolder();
            Restart("unlisted");
            var collection = await Open("live", keys);
            var asset = Asset();
            var codes = Codes(asset);
            await asset.ShowAsync();
            Expect.Lines(new string[0], codes);
            Expect.Equal(2, asset.Info.Version);
            await collection.EnsureAsync("bowl");
            Expect.Equal(AsyncOperationStatus.Succeeded, (await Load()).Status);
            Expect.Lines(new[] { "bowl", "cup" }, collection.Keys);
            Facts.Ask("turn/removed");
            await asset.FollowAsync();
            Expect.Lines(new[] { CaptureFault.AssetRemoved }, codes);
            asset.Release();
        }
    }

    public static async Task ACollectionWhoseUnityCatalogueIsYetToComeIsThereAtOnce()
    {
        Restart("young");
        var collection = await Open("live", Key);
        Expect.Lines(new[] { "bowl", "cup" }, collection.Keys);
        Expect.Lines(new[] { "bowl", "cup" }, collection.WithLabel("round"));
        Expect.Equal(2, (await Locations("kitchen")).Count);
        var handle = await Load();
        Expect.Equal(2, handle.Result.GetComponent<CapturedInfo>().Version);
        Facts.Ask("turn/v2");
        await Catalogue.UpdateAsync();
        Expect.Lines(new[] { "bowl", "cup" }, collection.Keys);
        Expect.Equal(1, (await Locations(Bowl)).Count);
        Expect.Equal(2, (await Locations("kitchen")).Count);
        Addressables.Release(handle);
        NothingIsLeft();
    }

    // The wall of pictures.

    private static async Task<Pick> Wall(string way = "live")
    {
        var wall = new GameObject("wall").AddComponent<Pick>();
        Set(wall, "baseUrl", $"{Facts.Server}/{way}");
        Set(wall, "publicKey", Key);
        await wall.OpenAsync();
        return wall;
    }

    private static void Set(object target, string field, string value)
    {
        target.GetType().GetField(field, BindingFlags.Instance | BindingFlags.NonPublic).SetValue(target, value);
    }

    private static IEnumerable<GameObject> Cards() => Object.Alive.OfType<XRSimpleInteractable>().Select(each => each.gameObject);

    private static IEnumerable<string> Names() => Cards().Select(each => each.name);

    private static void Choose(string card) => Cards().First(each => each.name == card).GetComponent<XRSimpleInteractable>().Select();

    public static async Task TheWallHasPicturesOfAllAssetsAndTheirLabels()
    {
        var wall = await Wall();
        Expect.Lines(new[] { "All", "kitchen", "round", "Bowl", "Bowl" }, Names());
        Expect.Equal(1, wall.Pages);
        var pictures = Object.Alive.OfType<Texture2D>().ToList();
        Expect.Equal(1, pictures.Count);
        var rows = await Catalogue.Opened[0].RowsAsync();
        Expect.Equal(rows[0].PreviewSha256, Sha256.Of(pictures[0].Loaded));
        Choose("round");
        Expect.Equal("round", wall.Label);
        Object.Destroy(wall.gameObject);
    }

    public static async Task WhatIsChosenOnTheWallIsShown()
    {
        await Wall();
        Cards().Last().GetComponent<XRSimpleInteractable>().Select();
        var asset = Object.Alive.OfType<CapturedAsset>().Single();
        Expect.Equal("cup", asset.Key);
        Expect.Equal("default", asset.Collection.Name);
        await asset.ShowAsync();
        Expect.Equal(1, asset.Info.Version);
        asset.Release();
    }

    public static async Task APageOfTheWallLeavesNothingBehind()
    {
        var wall = await Wall();
        var before = Object.Alive.Count;
        await wall.ShowAsync("", 0);
        Expect.Equal(before, Object.Alive.Count);
        Invoke(typeof(Pick), wall, "OnDestroy");
        Expect.Equal(0, Cards().Count() + Object.Alive.OfType<Texture2D>().Count() + Object.Alive.OfType<Material>().Count());
    }

    public static async Task AWallWhosePicturesCannotBeHadHasTheNames()
    {
        var wall = await Wall();
        Catalogue.Cache.Remove((await Catalogue.Opened[0].RowsAsync())[0].PreviewSha256);
        Facts.Ask("turn/off");
        await wall.ShowAsync("", 0);
        Expect.Lines(new[] { "All", "kitchen", "round", "Bowl", "Bowl" }, Names());
        Expect.Equal(1, Debug.Errors.Count);
    }

    private sealed class Told : IProgress<float>
    {
        public readonly List<float> Shares = new List<float>();

        public void Report(float value)
        {
            Object.OnMainThread();
            Shares.Add(value);
        }
    }

    public static async Task WhatIsShownStaysOnTheDeviceWhenItIsCleared()
    {
        var collection = await Open();
        var asset = Asset();
        await ShowAll(asset);
        Expect.Equal(0L, collection.Clear("bowl"));
        asset.Release();
        Expect.True(collection.Clear("bowl") > 0, "now nobody uses it");
    }

    public static async Task ACollectionThatIsNotThereAndOneThatCannotBeReadAreToldApart()
    {
        await Expect.Fault(CaptureFault.FileMissing, () => Catalogue.OpenAsync($"{Facts.Server}/live", "nobodys"));
        await Expect.Fault(CaptureFault.CatalogueUnreadable, () => Open("www/damaged"));
        Expect.Equal(0, Addressables.ResourceLocators.Count()); // they left nothing with Addressables
        var asset = Asset();
        var codes = Codes(asset);
        await asset.ShowAsync();
        Expect.Lines(new[] { CaptureFault.CollectionClosed }, codes);
    }
}
