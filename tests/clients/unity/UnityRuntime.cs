// What an app does with Unity's own Addressables and our package, each step measured: the bench unity-runtime starts it twice,
// with nothing on the device and then with what the first start has left there.
using System;
using System.Collections.Generic;
using System.Diagnostics;
using System.IO;
using System.Linq;
using System.Threading.Tasks;
using Capture2vr;
using UnityEngine;
using UnityEngine.AddressableAssets;
using UnityEngine.ResourceManagement.AsyncOperations;
using UnityEngine.ResourceManagement.ResourceLocations;
using UnityEngine.ResourceManagement.ResourceProviders;
using Debug = UnityEngine.Debug;

/// <summary>Prints a line for each step: its name, milliseconds, requests and bytes of the server.</summary>
public static class Step
{
    private static long[] Served => Facts.Ask("meter/now").Split(' ').Select(long.Parse).ToArray();

    public static async Task<T> Of<T>(string name, Func<Task<T>> act)
    {
        var before = Served;
        var time = Stopwatch.StartNew();
        var result = await act();
        time.Stop();
        var after = Served;
        Console.WriteLine($"step\t{name}\t{time.Elapsed.TotalMilliseconds:F1}\t{after[0] - before[0]}\t{after[1] - before[1]}");
        return result;
    }

    public static Task Of(string name, Func<Task> act)
    {
        return Of(name, async () =>
        {
            await act();
            return true;
        });
    }
}

/// <summary>Addressables' own calls, each handle released.</summary>
public static class Player
{
    public static void Start()
    {
        Application.streamingAssetsPath = Facts.All.In("app").Text();
        Application.persistentDataPath = Path.Combine(Facts.Scratch, "device");
        Engine.Start();
        var frame = Stopwatch.StartNew();
        Pump.InEachFrame = () =>
        {
            PlayerLoop.Frame((float)frame.Elapsed.TotalSeconds);
            frame.Restart();
        };
    }

    /// <summary>Addressables logs what it does not throw.</summary>
    public static async Task WithoutErrors(Func<Task> act)
    {
        try
        {
            await act();
        }
        finally
        {
            foreach (var each in Debug.Errors) Console.Error.WriteLine(each);
        }
        Expect.Equal(0, Debug.Errors.Count);
    }

    public static async Task<T> Result<T>(AsyncOperationHandle<T> handle)
    {
        await Ended(handle);
        if (handle.Status != AsyncOperationStatus.Succeeded) throw new Exception("it failed", handle.OperationException);
        return handle.Result;
    }

    public static Task Ended<T>(AsyncOperationHandle<T> handle)
    {
        var ended = new TaskCompletionSource<bool>();
        handle.Completed += _ => ended.SetResult(true);
        return ended.Task;
    }

    /// <summary>How many assets are loaded, or cloned.</summary>
    public static int Shown => UnityEngine.Object.Alive.OfType<LODGroup>().Count();

    public static Task<IList<IResourceLocation>> At(object key) => Taken(Addressables.LoadResourceLocationsAsync(key, typeof(GameObject)));

    public static Task<IList<IResourceLocation>> AtAny(IEnumerable<string> keys)
    {
        return Taken(Addressables.LoadResourceLocationsAsync(keys, Addressables.MergeMode.Union, typeof(GameObject)));
    }

    public static async Task<T> Taken<T>(AsyncOperationHandle<T> handle)
    {
        var result = await Result(handle);
        Addressables.Release(handle);
        return result;
    }

    /// <summary>An asset has three levels, and nobody holds it afterwards.</summary>
    public static async Task LoadAndLetGo(string key, int version)
    {
        var before = Shown;
        var handle = Addressables.LoadAssetAsync<GameObject>(key);
        var prefab = await Result(handle);
        Expect.Equal(version, prefab.GetComponent<CapturedInfo>().Version);
        Expect.Equal(3, prefab.GetComponent<LODGroup>().GetLODs().Length);
        Addressables.Release(handle);
        await Expect.Comes(() => Shown == before);
    }

    public static async Task IsAt(string key, int version) => Expect.Equal($"{key}@{version}", (await At(key)).Single().InternalId);

    public static async Task<OpenCollection> Open(string collection)
    {
        return await Catalogue.OpenAsync($"{Facts.Server}/is", collection, Facts.All.In("key").Text());
    }

    public static string Told(string collection, string what) => Facts.All.In(collection).In(what).Text();

    /// <summary>The key of the asset that a publication adds.</summary>
    public static string Added(string collection, int publication) => Facts.All.In(collection).In("added").List()[publication].Text();

    public static int Count(string collection, string what) => (int)Facts.All.In(collection).In(what).Whole();

    /// <summary>The publisher adds a version of one asset, and an asset.</summary>
    public static void Publish(string collection) => Expect.Equal("published", Facts.Ask($"publish/{collection}"));
}

public static class FirstStart
{
    private static void Prepare() => Player.Start();

    public static Task Runs() => Player.WithoutErrors(async () =>
    {
        await Step.Of("start Addressables", () => Player.Taken(Addressables.InitializeAsync(false)));
        await Large();
        await Small();
        await Young();
    });

    private static async Task Large()
    {
        const string name = "large";
        string old = "captures/" + Player.Told(name, "old"), added = "captures/" + Player.Added(name, 0);
        var collection = await Step.Of("large: open, its locator added", () => Player.Open(name));
        await Step.Of("large: an unknown key", () => IsNowhere("captures/nothing"));
        await Step.Of("large: an asset before EnsureAsync", () => IsNowhere(old));
        await Step.Of("large: EnsureAsync of one asset", () => collection.EnsureAsync(Player.Told(name, "old")));
        await Step.Of("large: by key", () => Player.IsAt(old, 1));
        await Step.Of("large: by a label, which is no key of a large collection", () => IsNowhere("published"));
        var keys = await Step.Of("large: WithLabelAsync", () => collection.WithLabelAsync("published"));
        Expect.Equal(Player.Count(name, "published"), keys.Count);
        await Step.Of("large: EnsureAsync of those", () => collection.EnsureAsync(keys.ToArray()));
        var several = await Step.Of("large: by their keys", () => Player.AtAny(keys.Select(each => "captures/" + each)));
        Expect.Equal(keys.Count, several.Count);
        var all = await Step.Of("large: WithLabelAsync of all others", () => collection.WithLabelAsync("wood"));
        Expect.Equal(Player.Count(name, "count") - keys.Count, all.Count);
        await Expect.Fault(CaptureFault.AssetUnknown, () => collection.EnsureAsync("nothing"));
        await Step.Of("large: load an asset, and let it go", () => Player.LoadAndLetGo(old, 1));
        Player.Publish(name);
        await Player.IsAt(old, 1);
        await Step.Of("large: UpdateAsync after a publication", collection.UpdateAsync);
        await Step.Of("large: by key, the new version", () => Player.IsAt(old, 2));
        await Step.Of("large: EnsureAsync of the new asset", () => collection.EnsureAsync(Player.Added(name, 0)));
        await Player.IsAt(added, 1);
        await Step.Of("large: load the new version, and let it go", () => Player.LoadAndLetGo(old, 2));
        await Player.LoadAndLetGo(added, 1);
    }

    private static async Task Small()
    {
        const string name = "small";
        string old = "captures/" + Player.Told(name, "old"), added = "captures/" + Player.Added(name, 0);
        await DamagedCatalogue(name);
        var collection = await Step.Of("small: open, LoadContentCatalogAsync within", () => Player.Open(name));
        await Step.Of("small: by key", () => Player.IsAt(old, 1));
        await Step.Of("small: an unknown key", () => IsNowhere("captures/nothing"));
        Expect.Equal(Player.Count(name, "published"), (await Step.Of("small: by a label of few", () => Player.At("published"))).Count);
        var others = Player.Count(name, "count") - Player.Count(name, "published");
        Expect.Equal(others, (await Step.Of("small: by a label of all others", () => Player.At("wood"))).Count);
        Expect.Equal(others, (await Step.Of("small: by that label again", () => Player.At("wood"))).Count);
        Expect.Equal(Player.Count(name, "count"), (await Step.Of("small: Keys", () => Task.FromResult(collection.Keys))).Count);
        var size = await Step.Of("small: GetDownloadSizeAsync", () => Player.Taken(Addressables.GetDownloadSizeAsync(old)));
        Expect.Equal(Facts.All.In(name).In("bytes").Whole(), size);
        await Step.Of("small: DownloadDependenciesAsync", () => Downloads(old));
        Expect.True(collection.IsCached(Player.Told(name, "old")), "the files are on the device");
        await Step.Of("small: load an asset, and let it go", () => Player.LoadAndLetGo(old, 1));
        Player.Publish(name);
        await Step.Of("small: UpdateAsync after a publication", collection.UpdateAsync);
        await Step.Of("small: by key, the new version", () => Player.IsAt(old, 2));
        await Step.Of("small: by key, the new asset", () => Player.IsAt(added, 1));
        Expect.Equal(Player.Count(name, "published") + 1, (await Step.Of("small: by the label", () => Player.At("published"))).Count);
        await Step.Of("small: load the new version, and let it go", () => Player.LoadAndLetGo(old, 2));
        await Step.Of("small: UpdateAsync, nothing new", collection.UpdateAsync);
    }

    private static async Task DamagedCatalogue(string collection)
    {
        Facts.Ask("damage/" + Catalogue.FileName);
        await Expect.Fault(CaptureFault.CatalogueUnreadable, () => Player.Open(collection));
        Facts.Ask("damage///");
        Debug.Errors.Clear();
    }

    /// <summary>Few assets, whose catalogue for Addressables the server has not written yet.</summary>
    private static async Task Young()
    {
        const string name = "young";
        var published = Player.Count(name, "published");
        await Step.Of("young: open, all in its locator", () => Player.Open(name));
        await Step.Of("young: by key", () => Player.IsAt("captures/" + Player.Told(name, "old"), 1));
        Expect.Equal(published, (await Step.Of("young: by a label", () => Player.At("young"))).Count);
        await Player.LoadAndLetGo("captures/" + Player.Told(name, "old"), 1);
    }

    private static async Task Downloads(string key)
    {
        var handle = Addressables.DownloadDependenciesAsync(key);
        await Expect.Comes(() => handle.IsDone);
        Expect.Equal(AsyncOperationStatus.Succeeded, handle.Status);
        Addressables.Release(handle);
    }

    private static async Task IsNowhere(string key) => Expect.Equal(0, (await Player.At(key)).Count);
}

/// <summary>With what the first start has left on the device.</summary>
public static class StartWithoutNetwork
{
    private static void Prepare() => Player.Start();

    public static async Task Runs()
    {
        Facts.Ask("turn/off");
        var old = Player.Told("large", "old");
        var large = await Step.Of("large, without a network: open", () => Player.Open("large"));
        await Step.Of("large, without a network: EnsureAsync of one asset", () => large.EnsureAsync(old));
        await Step.Of("large, without a network: load an asset, and let it go", () => Player.LoadAndLetGo("captures/" + old, 2));
        await Step.Of("small, without a network: open", () => Player.Open("small"));
        await Player.IsAt("captures/" + Player.Told("small", "old"), 2);
        await Player.LoadAndLetGo("captures/" + Player.Told("small", "old"), 2);
        Facts.Ask("turn/on");
    }
}

public static class SecondStart
{
    private static void Prepare() => Player.Start();

    public static Task Runs() => Player.WithoutErrors(async () =>
    {
        var large = await Step.Of("large, second start: Addressables started, open", () => Player.Open("large"));
        await Step.Of("large, second start: EnsureAsync of one asset", () => large.EnsureAsync(Player.Told("large", "old")));
        await Player.IsAt("captures/" + Player.Told("large", "old"), 2);
        var small = await Step.Of("small, second start: open, its catalogue is on the device", () => Player.Open("small"));
        await Player.IsAt("captures/" + Player.Told("small", "old"), 2);
        await Grows(small, "captures/" + Player.Told("small", "old"), "captures/" + Player.Added("small", 1));
    });
    /// <summary>One asset more than a catalogue for Addressables has room for: the server has none from now on.</summary>
    private static async Task Grows(OpenCollection collection, string old, string added)
    {
        Player.Publish("small");
        await Step.Of("small, grown large: UpdateAsync", collection.UpdateAsync);
        await Step.Of("small, grown large: EnsureAsync of two", () => collection.EnsureAsync(Player.Told("small", "old"), Player.Added("small", 1)));
        Expect.Equal(old + "@3", (await Player.At(old)).First().InternalId);
        await Player.IsAt(added, 1);
        await Step.Of("small, grown large: load the newest version, and let it go", () => Player.LoadAndLetGo(old, 3));
    }
}

/// <summary>What else an app does, and what goes wrong: the same answers as with the stand-ins for Addressables.</summary>
public static class OddStart
{
    private static readonly string Old = "captures/" + Player.Told("young", "old");

    private static void Prepare() => Player.Start();

    public static async Task Runs()
    {
        await SeveralOpenAtOnce();
        await AllOfALabel();
        await Clones();
        await NobodyMayWait();
        await AReleaseWhileItLoads();
        await WhatIsMissing();
        await WhatIsUnknown();
        await UpdatesAtOnce();
        await AnUpdateThatFails();
        Expect.Equal(0, Player.Shown);
    }

    /// <summary>The app's own start of Addressables, which lets go of itself, and three collections, one of them twice.</summary>
    private static async Task SeveralOpenAtOnce()
    {
        var starting = Addressables.InitializeAsync();
        var opened = await Task.WhenAll(new[] { "young", "large", "small", "young" }.Select(Player.Open));
        Expect.True(starting.IsDone, "Addressables has started");
        Expect.True(opened[0] == opened[3], "the same collection");
        var kept = Addressables.InitializeAsync(false);
        await Player.Open("young");
        Expect.True(kept.IsValid(), "the app's handle stays the app's");
        Addressables.Release(kept);
    }

    private static async Task AllOfALabel()
    {
        var made = new List<GameObject>();
        var handle = Addressables.LoadAssetsAsync<GameObject>("young", made.Add);
        var all = await Player.Result(handle);
        Expect.Equal(Player.Count("young", "published"), all.Count);
        Expect.Equal(all.Count, made.Distinct().Count());
        Addressables.Release(handle);
        await NothingIsLeft();
    }

    /// <summary>Two users of one prefab, and a clone that keeps it.</summary>
    private static async Task Clones()
    {
        var first = Addressables.InstantiateAsync(Old);
        var second = Addressables.LoadAssetAsync<GameObject>(Old);
        var clone = await Player.Result(first);
        Expect.Equal(1, clone.GetComponent<CapturedInfo>().Version);
        await Player.Result(second);
        Addressables.Release(second);
        Expect.Equal(2, Player.Shown);
        Expect.True(Addressables.ReleaseInstance(clone), "it is Addressables' own");
        await NothingIsLeft();
    }

    private static async Task NobodyMayWait()
    {
        var handle = Addressables.LoadAssetAsync<GameObject>(Old);
        Expect.Throws<NotSupportedException>(() => handle.WaitForCompletion());
        await Player.Result(handle);
        Addressables.Release(handle);
        await NothingIsLeft();
    }

    private static async Task AReleaseWhileItLoads()
    {
        var handle = Addressables.LoadAssetAsync<GameObject>(Old);
        Addressables.Release(handle);
        await NothingIsLeft();
        await Player.LoadAndLetGo(Old, 1);
    }

    /// <summary>A level that cannot be had leaves the others; all of them, a fault that says so.</summary>
    private static async Task WhatIsMissing()
    {
        Facts.Ask("lose/assets/young-001/lod0");
        var key = "captures/young-001";
        Expect.Equal(3, (await Player.At(key)).Single().Dependencies.Count);
        Catalogue.Opened.First(each => each.Name == "young").Clear("young-001");
        var handle = Addressables.LoadAssetAsync<GameObject>(key);
        Expect.Equal(2, (await Player.Result(handle)).GetComponent<LODGroup>().GetLODs().Length);
        Addressables.Release(handle);
        await NothingIsLeft();
        Facts.Ask("lose/assets/young-002/lod");
        Catalogue.Opened.First(each => each.Name == "young").Clear("young-002");
        Expect.Equal(CaptureFault.FileMissing, await Fault("captures/young-002"));
        Facts.Ask("lose///");
        await Player.LoadAndLetGo(key, 1);
        await Player.LoadAndLetGo("captures/young-002", 1);
    }

    private static async Task WhatIsUnknown()
    {
        var handle = Addressables.LoadAssetAsync<GameObject>("captures/nothing");
        await Player.Ended(handle);
        Expect.True(handle.OperationException is InvalidKeyException, $"unknown, not {handle.OperationException}");
        Addressables.Release(handle);
    }

    private static async Task<string> Fault(string key)
    {
        var handle = Addressables.LoadAssetAsync<GameObject>(key);
        await Player.Ended(handle);
        Expect.Equal(AsyncOperationStatus.Failed, handle.Status);
        var code = Catalogue.FaultOf(handle.OperationException)?.Code;
        Addressables.Release(handle);
        return code;
    }

    private static async Task UpdatesAtOnce()
    {
        var loading = Addressables.LoadAssetAsync<GameObject>(Old);
        Player.Publish("young");
        await Task.WhenAll(Catalogue.UpdateAsync(), Catalogue.UpdateAsync());
        Expect.Equal(1, (await Player.Result(loading)).GetComponent<CapturedInfo>().Version);
        await Player.LoadAndLetGo("captures/" + Player.Added("young", 0), 1);
        Addressables.Release(loading);
        await Player.LoadAndLetGo(Old, 2);
    }

    /// <summary>What changes is seen, and what it has changed to cannot be had: the next look has it.</summary>
    private static async Task AnUpdateThatFails()
    {
        var added = "captures/" + Player.Added("young", 1);
        Facts.Ask("lose/" + Catalogue.FileName);
        Player.Publish("young");
        await Catalogue.UpdateAsync();
        await Player.IsAt(Old, 2);
        Facts.Ask("lose///");
        await Catalogue.UpdateAsync();
        await Player.IsAt(Old, 3);
        await Player.LoadAndLetGo(added, 1);
    }

    private static Task NothingIsLeft() => Expect.Comes(() => Player.Shown == 0);
}

/// <summary>An app into which nobody has built Addressables' settings.</summary>
public static class StartWithoutSettings
{
    private static void Prepare()
    {
        Player.Start();
        Application.streamingAssetsPath += "/nothing";
    }

    public static async Task Runs()
    {
        await Expect.Fault(CaptureFault.FileMissing, () => Player.Open("nowhere"));
        await Player.Open("young");
        await Player.LoadAndLetGo("captures/" + Player.Told("young", "old"), 3);
        await Player.Open("large");
    }
}
