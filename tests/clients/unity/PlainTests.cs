// The parts that know no engine, against a real server that serves what the product has published.
using System;
using System.Collections.Generic;
using System.IO;
using System.Linq;
using System.Text;
using System.Threading.Tasks;
using Capture2vr;

public static class PlainTests
{
    private static readonly object Lod = Facts.All.In("lods").List()[2];
    private static string Sha => Lod.In("sha256").Text();
    private static long Size => Lod.In("bytes").Whole();
    private static string Name => Lod.In("name").Text();
    private static List<byte[]> Keys => new List<byte[]> { Convert.FromBase64String(Facts.All.In("key").Text()) };

#if UNITY_WEBGL
    private static readonly Transport Web = UnityHttp.Fetch;

    private static void Prepare() => Engine.Start();
#else
    private static readonly Transport Web = Http.Fetch;
#endif

    private static Task Fetch(string url, Stream into) => Web(url, into, new Dictionary<string, string>());

    private static string Url(string way = "www/v2") => $"{Facts.Server}/{way}/{Name}";

    private static FileCache Cache(string folder = null, long limit = 1 << 30, Fetch fetch = null)
    {
        return new FileCache(folder ?? Facts.NewFolder(), limit, fetch ?? Fetch);
    }

    private static int Count(string way) => int.Parse(Facts.Ask($"count/{way}/{Name}"));

    private static Task NoNetwork(string url, Stream into)
    {
        throw new CaptureFault(CaptureFault.Unreachable, "no network");
    }

    // Hashes and names.

    public static void HashesAreThoseOfTheStandard()
    {
        const string abc = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        Expect.Equal(abc, Sha256.Of(Encoding.ASCII.GetBytes("abc")));
    }

    public static void TheNameOfAFileTellsItsHash()
    {
        Expect.Equal(Sha, Sha256.InName(Url() + "?v=1.glb"));
        var bad = new[] { "", "lod0.glb", $"{Sha}.glb", $"lod0.{Sha.ToUpperInvariant()}.glb", $"lod0.{Sha}x.glb", $"{Sha}/a.b.glb" };
        foreach (var each in bad) Expect.Equal(null, Sha256.InName(each));
    }

    // Headers.

    private static IReadOnlyDictionary<string, string> Shown(string key) => new Dictionary<string, string> { { "Authorization", key } };

    private static Task<IReadOnlyDictionary<string, string>> Good() => Task.FromResult(Shown("Bearer good"));

    public static async Task APrivateFileIsForWhoShowsTheKey()
    {
        Facts.Ask("turn/v2");
        var url = $"{Facts.Server}/keyed/{Name}";
        var access = new AccessHeaders(Facts.Server, Web);
        await Expect.Fault(CaptureFault.AccessRefused, () => Cache(fetch: access.Fetch).Load(url, Sha, Size).Task);
        access.Current = Shown("Bearer good");
        Expect.Equal(Sha, Sha256.Of(File.ReadAllBytes(await Cache(fetch: access.Fetch).Load(url, Sha, Size).Task)));
    }

    public static async Task RefusedHeadersAreRenewedOnceForAll()
    {
        Facts.Ask("turn/v2");
        var asked = 0;
        var access = new AccessHeaders(Facts.Server, Web) { Current = Shown("Bearer old") };
        access.Renewal = () =>
        {
            asked++;
            return Good();
        };
        var url = $"{Facts.Server}/keyed/{Name}";
        await Task.WhenAll(Enumerable.Range(0, 4).Select(_ => Cache(fetch: access.Fetch).Load(url, Sha, Size).Task));
        Expect.Equal(1, asked);
        access.Current = Shown("Bearer old");
        access.Renewal = () => Task.FromResult(Shown("Bearer worse"));
        await Expect.Fault(CaptureFault.AccessRefused, () => Cache(fetch: access.Fetch).Load(url, Sha, Size).Task);
    }

    public static void NothingElsewhereGetsTheHeaders()
    {
        var access = new AccessHeaders("https://vr.example/t/ada/", Web) { Current = Shown("Bearer good") };
        foreach (var each in new[] { "/assets/a.glb", "/", "/x/../y" }) Expect.Equal(1, access.For("https://vr.example/t/ada" + each).Count);
        var others = new[]
        {
            "http://vr.example/t/ada/a", "https://vr.example:8443/t/ada/a", "https://vr.example.evil/t/ada/a", "https://evil.example/t/ada/", "",
            null, "https://vr.example/t/adam/a", "https://vr.example/t/bob/a", "https://vr.example/t/ada/../bob/a", "https://vr.example/t/ada/%2e%2e/bob/a"
        };
        foreach (var each in others) Expect.Equal(0, access.For(each).Count);
        Expect.Equal(0, new AccessHeaders("nowhere", Web) { Current = Shown("Bearer good") }.For("https://vr.example/a").Count);
    }

    public static async Task WhatIsNoAddressIsNamed()
    {
        foreach (var each in new[] { "cdn.example/a", "/a", "ftp://cdn.example/a", "http:///a", "http://[::1", "" })
        {
            var fault = await Expect.Fault(CaptureFault.Unreachable, () => Http.Fetch(each, new MemoryStream()));
            Expect.True(fault.Message.StartsWith(each + " is no address"), fault.Message);
        }
    }

    public static async Task WhoIsRedirectedElsewhereShowsNoHeadersThere()
    {
#if UNITY_WEBGL // where the browser follows
        await Task.Yield();
#else
        Facts.Ask("turn/v2");
        var shown = new Dictionary<string, string> { { "Authorization", "Bearer good" }, { "X-Key", "good" } };
        using (var memory = new MemoryStream())
        {
            await Http.Fetch($"{Facts.Server}/away/{Name}", memory, shown);
            Expect.Equal(Sha, Sha256.Of(memory.ToArray()));
        }
#endif
    }

    // The cache.

    public static async Task WhatNobodyUsesMayBeRemoved()
    {
        var cache = Cache();
        Expect.True(!cache.Has(Sha, Size) && !cache.Remove(Sha), "nothing is here yet");
        await cache.Load(Url(), Sha, Size).Task;
        Expect.True(cache.Has(Sha, Size) && cache.Has(Sha, -1) && !cache.Has(Sha, Size + 1), "it is here, of its size");
        Expect.True(!cache.Remove(Sha), "somebody uses it");
        cache.Release(Sha);
        Expect.True(cache.Remove(Sha) && !cache.Has(Sha, Size), "it is gone");
        Expect.Equal(0L, cache.Bytes);
    }

    public static async Task WhatWasLoadedOnceIsThereWithoutANetwork()
    {
        var folder = Facts.NewFolder();
        var path = await Cache(folder).Load(Url(), Sha, Size).Task;
        Expect.Equal(Sha, Sha256.Of(File.ReadAllBytes(path)));
        Expect.Equal(path, await Cache(folder, fetch: NoNetwork).Load(Url(), Sha, Size).Task);
    }

    public static async Task AFlippedBitIsHealed()
    {
        var cache = Cache();
        var before = Count("www/healed");
        var path = await cache.Load(Url("www/healed"), Sha, Size).Task;
        var data = File.ReadAllBytes(path);
        data[data.Length / 2] ^= 4;
        File.WriteAllBytes(path, data);
        Expect.Equal(path, await cache.Load(Url("www/healed"), Sha, Size).Task);
        Expect.Equal(Sha, Sha256.Of(File.ReadAllBytes(path)));
        Expect.Equal(before + 2, Count("www/healed"));
    }

    public static async Task WithoutANetworkADamagedFileIsNotShown()
    {
        var folder = Facts.NewFolder();
        var path = await Cache(folder).Load(Url(), Sha, Size).Task;
        File.WriteAllText(path, "");
        await Expect.Fault(CaptureFault.Unreachable, () => Cache(folder, fetch: NoNetwork).Load(Url(), Sha, Size).Task);
    }

    public static async Task AFileWithAnotherHashIsRefusedAndNotKept()
    {
        var folder = Facts.NewFolder();
        await Expect.Fault(CaptureFault.FileChanged, () => Cache(folder).Load(Url("flip/v2"), Sha, Size).Task);
        Expect.Equal(0, Directory.GetFiles(folder).Length);
    }

    public static async Task AServerThatSendsTooMuchIsCutOff()
    {
        var fault = await Expect.Fault(CaptureFault.FileChanged, () => Cache().Load(Url("endless/v2"), Sha, Size).Task);
        Expect.True(fault.Message.Contains("sends more than"), fault.Message);
    }

    public static async Task ABrokenConnectionIsNoTampering()
    {
        await Expect.Fault(CaptureFault.Unreachable, () => Cache().Load(Url("cut/v2"), Sha, Size).Task);
    }

    public static async Task AMissingFileAndAServerInTroubleAreToldApart()
    {
        await Expect.Fault(CaptureFault.FileMissing, () => Cache().Load(Url("www/nowhere"), Sha, Size).Task);
        await Expect.Fault(CaptureFault.Unreachable, () => Cache().Load(Url("busy/v2"), Sha, Size).Task);
        await Expect.Fault(CaptureFault.Unreachable, () => Cache().Load("http://127.0.0.1:9/x", Sha, Size).Task);
    }

    public static async Task LoadsAtTheSameTimeDownloadOnce()
    {
        var cache = Cache();
        var before = Count("slow/once");
        var loads = Enumerable.Range(0, 8).Select(each => cache.Load(Url("slow/once"), Sha, Size)).ToList();
        await Task.WhenAll(loads.Select(each => each.Task));
        Expect.Equal(before + 1, Count("slow/once"));
        for (var each = 0; each < 8; each++) cache.Release(Sha);
        Expect.Throws<InvalidOperationException>(() => cache.Release(Sha));
    }

    public static async Task AfterAFailureTheNextLoadTriesAgain()
    {
        var cache = Cache();
        var loads = Enumerable.Range(0, 3).Select(each => cache.Load(Url("flip/v2"), Sha, Size).Task).ToList();
        foreach (var each in loads) await Expect.Fault(CaptureFault.FileChanged, () => each);
        Expect.Throws<InvalidOperationException>(() => cache.Release(Sha));
        await cache.Load(Url(), Sha, Size).Task;
        cache.Release(Sha);
    }

    public static async Task TheLongestUnusedGoesFirst()
    {
        var cache = Cache(limit: 250, fetch: Numbered);
        foreach (var number in new[] { 1, 2, 1, 3 }) await Use(cache, number);
        Expect.Lines(new[] { "yes", "no", "yes" }, new[] { 1, 2, 3 }.Select(number => Has(cache, number)));
        Expect.Equal(200L, cache.Bytes);
    }

    public static async Task AfterARestartTheOldestGoesFirst()
    {
        var folder = Facts.NewFolder();
        var first = Cache(folder, 250, Numbered);
        foreach (var number in new[] { 1, 2 }) await Use(first, number);
        File.SetLastWriteTimeUtc(first.PathOf(HashOf(1)), DateTime.UtcNow.AddHours(-1));
        File.SetLastWriteTimeUtc(first.PathOf(HashOf(2)), DateTime.UtcNow.AddHours(-2));
        var second = Cache(folder, 250, Numbered);
        await Use(second, 3);
        Expect.Lines(new[] { "yes", "no", "yes" }, new[] { 1, 2, 3 }.Select(number => Has(second, number)));
    }

    public static async Task WhatIsInUseStaysWhateverItTakes()
    {
        var cache = Cache(limit: 50, fetch: Numbered);
        await cache.Load("1", HashOf(1), 100).Task;
        await Use(cache, 2);
        await Use(cache, 3);
        Expect.Lines(new[] { "yes", "no" }, new[] { 1, 2 }.Select(number => Has(cache, number)));
        cache.Release(HashOf(1));
        await Use(cache, 4);
        Expect.Equal("no", Has(cache, 1));
    }

    public static async Task WhatACrashLeftIsSweptAndAClearedFolderIsMadeAgain()
    {
        var folder = Facts.NewFolder();
        File.WriteAllText(Path.Combine(folder, Sha + ".x.part"), "half");
        var cache = Cache(folder);
        Expect.Equal(0, Directory.GetFiles(folder).Length);
        Directory.Delete(folder);
        await cache.Load(Url(), Sha, Size).Task;
    }

    public static async Task ADeviceThatCannotKeepAFileSaysSo()
    {
        var folder = Facts.NewFolder();
        var cache = Cache(folder);
        Directory.Delete(folder);
        File.WriteAllText(folder, "a file where the folder was");
        var fault = await Expect.Fault(CaptureFault.StorageFailed, () => cache.Load(Url(), Sha, Size).Task);
        Expect.True(fault.Message.Contains("Free some storage"), fault.Message);
    }

    public static async Task ProgressEndsAtTheSize()
    {
        var download = Cache().Load(Url(), Sha, Size);
        await download.Task;
        Expect.Equal(Size, download.Received);
    }

    // Signatures.

    public static async Task SignaturesOfTheProductHoldAndOthersDoNot()
    {
        foreach (var each in Facts.All.In("signatures").List())
        {
            var bytes = new[] { "key", "message", "signature" }.Select(name => Convert.FromBase64String(each.In(name).Text())).ToArray();
            Expect.Equal((bool)each.In("holds"), await Ed25519.VerifyAsync(bytes[0], bytes[1], bytes[2]));
        }
    }

    public static async Task SignaturesOfTheWrongLengthDoNotHold()
    {
        Expect.True(!await Ed25519.VerifyAsync(new byte[31], new byte[0], new byte[64]), "a short key");
        Expect.True(!await Ed25519.VerifyAsync(new byte[32], new byte[0], new byte[63]), "a short signature");
    }

    // The signed catalogue.

    private const string Root = "root.json";

    /// <summary>A root as a tree has it, and one as earlier releases have it.</summary>
    private static async Task<byte[][]> Roots() => new[] { await RootData("tree2/collections/default/root.json"), await RootData("flat/collections/default/index.json") };

    private static async Task<byte[]> RootData(string name)
    {
        using (var memory = new MemoryStream())
        {
            await Fetch($"{Facts.Server}/www/{name}", memory);
            return memory.ToArray();
        }
    }

    private static Task<CollectionRoot> Read(byte[] data, IReadOnlyList<byte[]> keys, string collection = "default")
    {
        return CollectionRoot.ReadAsync(data, Root, collection, keys);
    }

    private static CollectionReader Reader(string folder, string way = "www/v2", Fetch fetch = null)
    {
        var versions = new Versions(Path.Combine(folder, "versions.txt"));
        var cache = Cache(Path.Combine(folder, "files"), fetch: fetch);
        return new CollectionReader($"{Facts.Server}/{way}", "default", Keys, folder, cache, versions, fetch ?? Fetch);
    }

    public static async Task FromTheSignatureDownToTheFiles()
    {
        var manifest = await Reader(Facts.NewFolder()).ManifestOf("bowl");
        Expect.Lines(Facts.All.In("lods").List().Select(each => each.In("sha256").Text()), manifest.Lods.Select(each => each.Sha256));
        Expect.Lines(Facts.All.In("lods").List().Select(each => each.In("name").Text()), manifest.Lods.Select(each => each.ObjectName));
        Expect.Equal("metric", manifest.ScaleConfidence);
    }

    public static async Task RowsAreTheAssetsThatAreNotRemoved()
    {
        var rows = await Reader(Facts.NewFolder()).Rows();
        Expect.Lines(new[] { "bowl", "cup" }, rows.Select(each => each.Key));
        Expect.Equal("Bowl", rows[0].Label);
        Expect.Lines(new[] { "kitchen", "round" }, rows[0].Labels);
        Expect.Lines(new[] { "cup" }, (await Reader(Facts.NewFolder(), "www/removed").Rows()).Select(each => each.Key));
    }

    public static async Task APictureIsThatOfTheRow()
    {
        var reader = Reader(Facts.NewFolder());
        foreach (var row in await reader.Rows())
        {
            var picture = await reader.Preview(row);
            if (row.Key == "cup") Expect.Equal(null, picture);
            else Expect.Equal(row.PreviewSha256, Sha256.Of(picture));
        }
    }

    public static async Task WithoutKeysNoSignatureIsAskedFor()
    {
        var folder = Facts.NewFolder();
        var versions = new Versions(Path.Combine(folder, "versions.txt"));
        var reader = new CollectionReader($"{Facts.Server}/www/v2", "default", new byte[0][], folder, Cache(Path.Combine(folder, "files")), versions, Fetch);
        Expect.Equal(2, (await reader.Rows()).Count);
        await reader.Check("bowl", 2, new[] { "no hash" });
    }

    public static async Task FilesOfAnotherAssetAreNotSignedForThisOne()
    {
        var reader = Reader(Facts.NewFolder());
        await reader.Check("bowl", 2, new[] { Sha });
        await Expect.Fault(CaptureFault.FileNotSigned, () => reader.Check("cup", 1, new[] { Sha }));
        await Expect.Fault(CaptureFault.FileNotSigned, () => reader.Check("bowl", 900, new[] { Sha }));
        await Expect.Fault(CaptureFault.AssetUnknown, () => reader.Check("nobody", 1, new[] { Sha }));
    }

    public static async Task ARemovedAssetIsNotSignedAnyMore()
    {
        var folder = Facts.NewFolder();
        await Reader(folder).Check("bowl", 2, new[] { Sha });
        await Expect.Fault(CaptureFault.AssetRemoved, () => Reader(folder, "www/removed").Check("bowl", 2, new[] { Sha }));
    }

    public static async Task EveryChangeOfTheTextIsNoticed()
    {
        foreach (var data in await Roots())
        {
            var from = Encoding.UTF8.GetString(data).IndexOf("version", StringComparison.Ordinal);
            for (var place = from; place < data.Length; place += 61)
            {
                var changed = (byte[])data.Clone();
                changed[place] ^= 1;
                var fault = await Expect.Fault(() => Read(changed, Keys));
                var known = new[] { CaptureFault.SignatureWrong, CaptureFault.CatalogueTruncated, CaptureFault.KeyUnknown };
                Expect.True(known.Contains(fault.Code), $"{fault.Code} at {place}");
            }
        }
    }

    public static async Task ACutCatalogueIsRefusedWherever()
    {
        foreach (var data in await Roots())
        {
            for (var length = 0; length < data.Length; length += 37)
            {
                var cut = data.Take(length).ToArray();
                await Expect.Fault(CaptureFault.CatalogueTruncated, () => Read(cut, Keys));
            }
        }
    }

    public static async Task OneBelievedSignatureIsAskedFor()
    {
        var stranger = new List<byte[]> { new byte[32] };
        var both = stranger.Concat(Keys).ToList();
        foreach (var data in await Roots())
        {
            await Expect.Fault(CaptureFault.KeyUnknown, () => Read(data, stranger));
            await Read(data, both);
            await Expect.Fault(CaptureFault.CatalogueOther, () => Read(data, Keys, "shoes"));
        }
        var unsigned = Encoding.UTF8.GetBytes("{\"signed\": \"{}\", \"signatures\": []}");
        await Expect.Fault(CaptureFault.SignatureMissing, () => Read(unsigned, Keys));
    }

    public static async Task AnOlderCatalogueIsRefusedHoweverWellSigned()
    {
        var folder = Facts.NewFolder();
        await Reader(folder, "www/v1").ManifestOf("bowl");
        await Reader(folder, "www/v2").ManifestOf("bowl");
        var fault = await Expect.Fault(CaptureFault.CatalogueOlder, () => Reader(folder, "www/v1").ManifestOf("bowl"));
        Expect.True(fault.Message.Contains("out of date"), fault.Message);
    }

    public static async Task WithoutANetworkTheLastGoodCatalogueCounts()
    {
        var folder = Facts.NewFolder();
        await Expect.Fault(CaptureFault.Unreachable, () => Reader(folder, fetch: NoNetwork).ManifestOf("bowl"));
        await Reader(folder).ManifestOf("bowl");
        await Reader(folder, fetch: NoNetwork).ManifestOf("bowl");
        var kept = Path.Combine(folder, "index.default.json");
        File.WriteAllText(kept, File.ReadAllText(kept).Replace("version", "versiom"));
        await Expect.Fault(CaptureFault.SignatureWrong, () => Reader(folder, fetch: NoNetwork).ManifestOf("bowl"));
    }

    // Trees.

    private static readonly string[] Trees = { "www/tree0", "www/tree1", "www/tree2" };

    private static string NameOf(string url) => url.Substring(url.LastIndexOf('/') + 1);

    /// <summary>What a reader asks the server for.</summary>
    private static Fetch Noting(List<string> names, Fetch fetch = null)
    {
        return (url, into) =>
        {
            lock (names) names.Add(NameOf(url).Split('.')[0]);
            return (fetch ?? Fetch)(url, into);
        };
    }

    public static async Task TreesOfAnyDepthHaveTheSameRows()
    {
        foreach (var tree in Trees)
        {
            var rows = await Reader(Facts.NewFolder(), tree).Rows();
            Expect.Lines(Facts.All.In("tree_keys").List().Select(each => each.Text()), rows.Select(each => each.Key));
            Expect.Lines(new[] { "kitchen", "round" }, rows.Single(each => each.Key == "bowl").Labels);
        }
    }

    public static async Task AKeyIsFoundInATreeOfAnyDepth()
    {
        foreach (var tree in Trees)
        {
            var reader = Reader(Facts.NewFolder(), tree);
            var lods = Facts.All.In("lods").List().Select(each => each.In("sha256").Text());
            Expect.Lines(lods, (await reader.ManifestOf("bowl")).Lods.Select(each => each.Sha256));
            foreach (var key in new[] { "0", "a", "a-00001", "bowk", "bowls", "cuq", "zz" })
            {
                await Expect.Fault(CaptureFault.AssetUnknown, () => reader.ManifestOf(key));
            }
            await Expect.Fault(CaptureFault.AssetRemoved, () => reader.ManifestOf("a-00006"));
            await reader.Check("bowl", 2, new[] { Sha });
            await Expect.Fault(CaptureFault.FileNotSigned, () => reader.Check("cup", 1, new[] { Sha }));
        }
    }

    public static async Task OfATreeOnlyTheWayIsRead()
    {
        var names = new List<string>();
        var reader = Reader(Facts.NewFolder(), "www/tree2", Noting(names));
        await reader.ManifestOf("bowl");
        Expect.Lines(new[] { "root", "node", "node", "shard", "manifest" }, names);
        await reader.ManifestOf("bowl");
        Expect.Equal("root", names.Last()); // the rest is on the device
        names.Clear();
        var both = await reader.Assets(new[] { "bowl", "cup", "bowl" });
        Expect.Lines(new[] { "bowl", "cup" }, both.Select(each => each.Row.Key).OrderBy(each => each));
        Expect.Equal(1, names.Count(each => each == "root"));
    }

    public static async Task ANodeThatIsMissingLetsItBeginAgainAtTheRoot()
    {
        foreach (var missing in new[] { 2, 3 })
        {
            var names = new List<string>();
            var left = missing;
            Fetch holed = (url, into) =>
            {
                if (!NameOf(url).StartsWith("node") || left-- <= 0) return Fetch(url, into);
                throw new CaptureFault(CaptureFault.FileMissing, "a newer one has come");
            };
            var reader = Reader(Facts.NewFolder(), "www/tree2", Noting(names, holed));
            if (missing == 2) await reader.ManifestOf("bowl");
            else await Expect.Fault(CaptureFault.FileMissing, () => reader.ManifestOf("bowl"));
            Expect.Equal(3, names.Count(each => each == "root"));
        }
    }

    public static async Task ANodeOfOtherBytesIsRefused()
    {
        foreach (var kind in new[] { "node", "shard" })
        {
            Fetch flipping = async (url, into) =>
            {
                using (var memory = new MemoryStream())
                {
                    await Fetch(url, memory);
                    var data = memory.ToArray();
                    if (NameOf(url).StartsWith(kind)) data[data.Length / 2] ^= 1;
                    into.Write(data, 0, data.Length);
                }
            };
            var folder = Facts.NewFolder();
            await Expect.Fault(CaptureFault.FileChanged, () => Reader(folder, "www/tree2", flipping).ManifestOf("bowl"));
            await Expect.Fault(CaptureFault.FileChanged, () => Reader(folder, "www/tree2", flipping).Rows());
            await Reader(folder, "www/tree2").ManifestOf("bowl"); // and not kept
        }
    }

    public static async Task AnOlderRootIsRefused()
    {
        var folder = Facts.NewFolder();
        await Reader(folder, "www/tree2").Rows();
        await Expect.Fault(CaptureFault.CatalogueOlder, () => Reader(folder, "www/older").Rows());
        await Expect.Fault(CaptureFault.CatalogueOlder, () => Reader(folder, "www/flat").ManifestOf("bowl")); // nor an index of before
    }

    public static async Task WithoutANetworkTheLastGoodTreeCounts()
    {
        var folder = Facts.NewFolder();
        await Expect.Fault(CaptureFault.Unreachable, () => Reader(folder, "www/tree2", NoNetwork).Rows());
        var rows = await Reader(folder, "www/tree2").Rows();
        await Reader(folder, "www/tree2").ManifestOf("bowl");
        Expect.Lines(rows.Select(each => each.Key), (await Reader(folder, "www/tree2", NoNetwork).Rows()).Select(each => each.Key));
        await Reader(folder, "www/tree2", NoNetwork).ManifestOf("bowl");
    }

    public static async Task AStoreOfAnEarlierReleaseIsReadByItsIndex()
    {
        var names = new List<string>();
        Expect.Equal(2, (await Reader(Facts.NewFolder(), "www/flat", Noting(names)).Rows()).Count);
        Expect.Lines(new[] { "root", "index", "shard" }, names);
    }

    public static async Task ABucketThatSaysRefusedForMissingIsReadByItsIndex()
    {
        Fetch shut = (url, into) =>
        {
            if (NameOf(url) == Root) throw new CaptureFault(CaptureFault.AccessRefused, "nobody may list it");
            return Fetch(url, into);
        };
        Expect.Equal(2, (await Reader(Facts.NewFolder(), "www/flat", shut).Rows()).Count);
    }

    public static async Task OfATreeThatHasGrownOnlyTheChangesAreRead()
    {
        var folder = Facts.NewFolder();
        var reader = Reader(folder, "www/large1");
        var known = await reader.Assets(new[] { "bowl", "cup", "asset-00007", "asset-00100", "asset-00101", "asset-00200" });
        Expect.Equal(0, (await reader.Changes(known)).Count);
        var names = new List<string>();
        var changes = await Reader(folder, "www/large2", Noting(names)).Changes(known);
        Expect.Lines(new[] { "root", "node", "node", "node", "shard", "shard", "manifest" }, names.OrderBy(each => "rnsm".IndexOf(each[0])));
        Expect.Equal(null, changes["asset-00100"]);
        Expect.Equal(2L, changes["bowl"].Row.Version);
        foreach (var same in new[] { "cup", "asset-00007", "asset-00101", "asset-00200" })
        {
            Expect.Equal(102L, changes[same].CatalogueVersion);
            Expect.True(changes[same].Manifest == known.Single(each => each.Row.Key == same).Manifest, $"{same} is as it was");
        }
    }

    public static async Task WhatIsNoTreeIsRefused()
    {
        var sha256 = new string('A', 43);
        var good = Tree(1, $"[\"{sha256}\", 9, 1, \"a\", \"a\"]");
        Expect.Equal(1, (await Read(good, new byte[0][])).Children.Count);
        var bad = new[]
        {
            Tree(9, ""), Tree(-1, ""), Tree(1, $"[\"{sha256}\", 0, 1, \"a\", \"a\"]"), Tree(1, $"[\"{sha256}\", 99999999, 1, \"a\", \"a\"]"),
            Tree(1, $"[\"{sha256}A\", 9, 1, \"a\", \"a\"]"), Tree(1, $"[\"{sha256}\", 9]"), Tree(1, "7"),
        };
        foreach (var each in bad) await Expect.Fault(CaptureFault.CatalogueTruncated, () => Read(each, new byte[0][]));
    }

    private static byte[] Tree(int depth, string child)
    {
        var text = $"{{\"collection\": \"default\", \"version\": 1, \"count\": 1, \"depth\": {depth}, \"columns\": "
            + $"[\"sha256\", \"bytes\", \"count\", \"first\", \"last\"], \"children\": [{child}]}}";
        return Encoding.UTF8.GetBytes($"{{\"signed\": \"{text.Replace("\"", "\\\"")}\", \"signatures\": []}}");
    }

    public static async Task AnEmptyTreeHasNoAsset()
    {
        Fetch empty = (url, into) =>
        {
            var data = Tree(0, "");
            into.Write(data, 0, data.Length);
            return Task.CompletedTask;
        };
        var folder = Facts.NewFolder();
        var versions = new Versions(Path.Combine(folder, "versions.txt"));
        var reader = new CollectionReader("http://nowhere", "default", new byte[0][], folder, Cache(Path.Combine(folder, "files")), versions, empty);
        Expect.Equal(0, (await reader.Rows()).Count);
        await Expect.Fault(CaptureFault.AssetUnknown, () => reader.ManifestOf("bowl"));
    }

    // Versions.

    public static void VersionsOnlyGrowAlsoAcrossStarts()
    {
        var path = Path.Combine(Facts.NewFolder(), "versions.txt");
        var versions = new Versions(path);
        foreach (var version in new[] { 3, 3, 7 }) versions.Check("a shoe", version);
        versions.Check("another", 1);
        var again = new Versions(path);
        Expect.Equal(CaptureFault.CatalogueOlder, Expect.Throws<CaptureFault>(() => again.Check("a shoe", 6)).Code);
        again.Check("a shoe", 7);
        again.Check("another", 2);
    }

    public static void ATornListOfVersionsIsReadAsFarAsItGoes()
    {
        var path = Path.Combine(Facts.NewFolder(), "versions.txt");
        File.WriteAllText(path, "7 shoe\nx\n99999999999999999999 big\n-1 minus\n\n3");
        var versions = new Versions(path);
        Expect.Throws<CaptureFault>(() => versions.Check("shoe", 6));
        versions.Check("big", 1);
        versions.Check("minus", 0);
    }

    // JSON.

    public static void JsonIsReadAsItIsWritten()
    {
        var found = Json.Parse(" {\"a\" : [1, -2.5e1, true, false, null, \"\\u00e9\\n\\\"\\/é\"], \"b\":{}, \"c\":[]} ");
        var items = found.In("a").List();
        Expect.Equal(1L, items[0].Whole());
        Expect.Equal(-25.0, (double)items[1]);
        Expect.Equal(true, (bool)items[2]);
        Expect.Equal(null, items[4]);
        Expect.Equal("é\n\"/é", items[5].Text());
        Expect.Equal(0, found.In("c").List().Count);
    }

    public static void WhatIsNoJsonIsRefused()
    {
        const string whole = "{\"a\": [1, \"x\\u0041\", true, null], \"b\": {\"c\": -1.5}}";
        for (var length = 0; length < whole.Length; length++) Refused(whole.Substring(0, length));
        foreach (var each in new[] { "1 2", "{\"a\" 1}", "[1 2]", "[1,]", "\"\t\"", "\"\\x\"", "nul", "--1", "{1:2}" }) Refused(each);
        Refused(new string('[', 100_000));
    }

    public static void WhatIsNotThereIsNamed()
    {
        Expect.True(Expect.Throws<FormatException>(() => Json.Parse("{}").In("signed")).Message.Contains("signed"), "no name");
        Expect.Throws<FormatException>(() => Json.Parse("[1]").List().At(1));
        Expect.Throws<FormatException>(() => Json.Parse("1.5").Whole());
        Expect.Throws<FormatException>(() => Json.Parse("1").Text());
    }

    // What is shown, and where.

    public static void CoarserLevelsAreForSmallerSharesOfTheView()
    {
        var levels = new[] { 0, 1, 2 };
        Expect.Lines(new[] { "0.3", "0.1", "0" }, LodChoice.Transitions(levels).Select(each => each.ToString()));
        Expect.Lines(new[] { "0", "0", "1", "2", "2" }, new[] { 1f, 0.3f, 0.2f, 0.05f, 0f }.Select(share => LodChoice.Place(levels, share).ToString()));
    }

    public static void AnyLevelsThereAreFillTheWholeRange()
    {
        foreach (var levels in new[] { new[] { 0 }, new[] { 2 }, new[] { 0, 2 }, new[] { 1, 2 }, new[] { 0, 1, 2, 3, 4, 5 } })
        {
            var transitions = LodChoice.Transitions(levels);
            Expect.Equal(0f, transitions.Last());
            for (var place = 1; place < levels.Length; place++) Expect.True(transitions[place] < transitions[place - 1], "heights fall");
            Expect.Equal(levels.Length - 1, LodChoice.Place(levels, 0));
        }
    }

    public static void ALargeThingStandsOnTheFloorAheadAndFacesTheViewer()
    {
        var place = Placement.Ahead(new[] { 1f, 1.7f, 2f }, new[] { 3f, -9f, 0f }, new[] { 0.6f, 1.8f, 0.4f }, 0.1f);
        Expect.Near(2.5, place.X);
        Expect.Near(0.1, place.Y);
        Expect.Near(2, place.Z);
        Expect.Near(-Math.PI / 2, place.Yaw); // its front, +Z, then points along -X: back to the viewer
    }

    public static void ASmallThingIsLiftedToAComfortableHeight()
    {
        var place = Placement.Ahead(new[] { 0f, 1.6f, 0f }, new[] { 0f, 0f, 1f }, new[] { 0.2f, 0.4f, 0.2f }, 0);
        Expect.Near(1.0, place.Y); // its middle at 1.2 m, three quarters of the eyes' height
        Expect.Near(1.5, place.Z);
        var seated = Placement.Ahead(new[] { 0f, 0.1f, 0f }, new[] { 0f, 0f, 1f }, new[] { 0.2f, 0.4f, 0.2f }, 0);
        Expect.Near(0, seated.Y); // never below the floor
    }

    public static void WhoLooksStraightDownAndWhatIsHugeStillHaveAPlace()
    {
        var down = Placement.Ahead(new[] { 0f, 1.6f, 0f }, new[] { 0f, -1f, 0f }, new[] { 1f, 1f, 1f }, 0);
        Expect.Near(1.5, down.Z);
        var huge = Placement.Ahead(new[] { 0f, 1.6f, 0f }, new[] { 0f, 0f, 1f }, new[] { 8f, 3f, 4f }, 0);
        Expect.Near(4.5, huge.Z); // half a metre before its near side, were it turned the long way
    }

    public static void HandsCannotLoseAThingOrFillTheRoomWithIt()
    {
        Expect.Near(2, Placement.Scale(2, 0.5f));
        Expect.Near(40, Placement.Scale(1000, 0.5f));
        Expect.Near(0.04, Placement.Scale(0, 0.5f));
        Expect.Near(1, Placement.Scale(5, 100));
        Expect.Near(1, Placement.Scale(0.1f, 0.001f));
        Expect.Near(1, Placement.Scale(float.NaN, 1));
        Expect.Near(1, Placement.Scale(3, 0));
    }

    public static void TheLastUserIsTold()
    {
        var counts = new RefCounts();
        counts.Take("a");
        counts.Take("a");
        Expect.True(!counts.Give("a"), "one is left");
        Expect.True(counts.Give("a"), "none is left");
        Expect.True(!counts.Held("a"), "it is free");
        Expect.Throws<InvalidOperationException>(() => counts.Give("a"));
    }

    private static void Refused(string text) => Expect.Throws<FormatException>(() => Json.Parse(text));

    // Files of 100 bytes whose address is their number.

    private static byte[] Content(int number) => Encoding.ASCII.GetBytes(number.ToString().PadLeft(100));

    private static string HashOf(int number) => Sha256.Of(Content(number));

    private static Task Numbered(string url, Stream into)
    {
        into.Write(Content(int.Parse(url)), 0, 100);
        return Task.CompletedTask;
    }

    private static async Task Use(FileCache cache, int number)
    {
        await cache.Load(number.ToString(), HashOf(number), 100).Task;
        cache.Release(HashOf(number));
    }

    private static string Has(FileCache cache, int number) => File.Exists(cache.PathOf(HashOf(number))) ? "yes" : "no";
}
