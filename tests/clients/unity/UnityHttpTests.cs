// Fetching by UnityWebRequest, on the stub of it, from a real server: in the WebGL player, where nothing else works, and
// elsewhere, where it may be chosen. What a fault means is checked by PlainTests too, which use it in the WebGL player.
using System;
using System.Collections.Generic;
using System.IO;
using System.Linq;
using System.Reflection;
using System.Security.Cryptography;
using System.Threading;
using System.Threading.Tasks;
using Capture2vr;
using UnityEngine;
using UnityEngine.AddressableAssets;
using UnityEngine.Networking;
using Object = UnityEngine.Object;

public static class UnityHttpTests
{
    private static readonly object Lod = Facts.All.In("lods").List()[0];
    private static readonly Dictionary<string, string> None = new Dictionary<string, string>();
    private static readonly Transport Usual = Catalogue.Transport;

    private static string Url(string way) => $"{Facts.Server}/{way}/{Lod.In("name").Text()}";

    private static void Prepare()
    {
        Application.persistentDataPath = Facts.NewFolder();
        Engine.Start();
        Catalogue.Transport = Usual;
        Object.Alive.Clear();
        typeof(Catalogue).GetMethod("Forget", BindingFlags.Static | BindingFlags.NonPublic).Invoke(null, null);
        Addressables.Restart();
        Facts.Ask("turn/v2");
    }

    /// <summary>Remembers where its pieces were written, and may be full.</summary>
    private sealed class Notebook : MemoryStream
    {
        public readonly List<Thread> Threads = new List<Thread>();
        public int Room = int.MaxValue;

        public override void Write(byte[] buffer, int offset, int count)
        {
            if (Length + count > Room) throw new IOException("the disk is full");
            Threads.Add(Thread.CurrentThread);
            base.Write(buffer, offset, count);
        }
    }

    private static async Task<Notebook> Fetched(string url, Dictionary<string, string> headers = null, Notebook into = null)
    {
        var notebook = into ?? new Notebook();
        try
        {
            await UnityHttp.Fetch(url, notebook, headers ?? None);
        }
        finally
        {
            Expect.Equal(0, UnityWebRequest.Open);
        }
        return notebook;
    }

    public static async Task AFileComesInPiecesOnTheMainThread()
    {
        var notebook = await Fetched(Url("www/v2"));
        Expect.Equal(Lod.In("sha256").Text(), Sha256.Of(notebook.ToArray()));
        Expect.True(notebook.Threads.Count > 1, "several pieces");
        Expect.True(notebook.Threads.All(each => each == Object.MainThread), "on the main thread");
    }

    public static async Task FaultsHaveTheCodesOfHttp()
    {
        await Expect.Fault(CaptureFault.Unreachable, () => Fetched(Url("cut/v2")));
        await Expect.Fault(CaptureFault.Unreachable, () => Fetched(Url("busy/v2")));
        await Expect.Fault(CaptureFault.Unreachable, () => Fetched("http://127.0.0.1:9/x"));
        await Expect.Fault(CaptureFault.FileMissing, () => Fetched(Url("www/nowhere")));
        await Expect.Fault(CaptureFault.AccessRefused, () => Fetched(Url("keyed")));
        await Fetched(Url("keyed"), new Dictionary<string, string> { { "Authorization", "Bearer good" } });
    }

    public static async Task ThePageOfARefusalIsNotKept()
    {
        var notebook = new Notebook();
        foreach (var way in new[] { "keyed", "busy/v2", "www/nowhere" }) await Expect.Fault(() => Fetched(Url(way), null, notebook));
        Expect.Equal(0L, notebook.Length);
    }

    public static async Task AStreamThatIsFullEndsTheDownloadAndSaysWhy()
    {
        try
        {
            await Fetched(Url("www/v2"), null, new Notebook { Room = 5_000 });
        }
        catch (IOException fault)
        {
            Expect.Equal("the disk is full", fault.Message);
            return;
        }
        throw new Exception("it was written into a full stream");
    }

    public static async Task AServerThatFallsSilentIsLeft()
    {
        await WithPatience(0.3, async () =>
        {
            var fault = await Expect.Fault(CaptureFault.Unreachable, () => Fetched(Url("stall/v2")));
            Expect.True(fault.Message.Contains("sent nothing"), fault.Message);
        });
    }

    private static async Task WithPatience(double seconds, Func<Task> act)
    {
        var faults = typeof(Http).Assembly.GetType("Capture2vr.HttpFaults").GetField("Patience");
        var usual = faults.GetValue(null);
        faults.SetValue(null, TimeSpan.FromSeconds(seconds));
        try
        {
            await act();
        }
        finally
        {
            faults.SetValue(null, usual);
        }
    }

    public static async Task ACollectionIsOpenedAndShownByIt()
    {
        Catalogue.Transport = UnityHttp.Fetch;
        Catalogue.AccessTo($"{Facts.Server}/keyed").Renewal = () => Task.FromResult<IReadOnlyDictionary<string, string>>(
            new Dictionary<string, string> { { "Authorization", "Bearer good" } });
        var sent = UnityWebRequest.Sent;
        var collection = await Catalogue.OpenAsync($"{Facts.Server}/keyed", "default", Facts.All.In("key").Text());
        await collection.DownloadAsync("bowl");
        var asset = new GameObject("asset").AddComponent<CapturedAsset>();
        asset.Key = "bowl";
        await asset.ShowAsync();
        Expect.Equal(2, asset.Info.Version);
        asset.Release();
        Expect.Equal(0, UnityWebRequest.Open);
        Expect.True(UnityWebRequest.Sent > sent + 5, "hash, catalogue, index, shard, manifest and files");
    }

#if UNITY_WEBGL
    public static async Task TheThreadPoolRunsNothingHere()
    {
        var ran = false;
        var lost = Task.Run(() => ran = true);
        for (var frame = 0; frame < 50; frame++) await Task.Yield();
        Expect.True(!ran && !lost.IsCompleted, "what these tests rest upon");
    }

    public static void ItIsTheUsualWay() => Expect.True(Usual == UnityHttp.Fetch, "the WebGL player has no other");

    public static async Task FramesPassWhileABigFileIsHashed()
    {
        var data = new byte[24 << 20];
        var frames = Pump.Frames;
        using (var sha = SHA256.Create()) Expect.Equal(Sha256.Hex(sha.ComputeHash(data)), await Sha256.OfAsync(new MemoryStream(data)));
        Expect.True(Pump.Frames - frames >= 3, $"{Pump.Frames - frames} frames");
    }

    public static async Task FramesPassWhileASignatureIsChecked()
    {
        var told = Facts.All.In("signatures").List()[0];
        var bytes = new[] { "key", "message", "signature" }.Select(name => Convert.FromBase64String(told.In(name).Text())).ToArray();
        var frames = Pump.Frames;
        for (var each = 0; each < 4; each++) Expect.True(await Ed25519.VerifyAsync(bytes[0], bytes[1], bytes[2]), "it holds");
        Expect.True(Pump.Frames - frames >= 3, $"{Pump.Frames - frames} frames");
    }

    public static async Task ASlowServerMayTakeAnyTime()
    {
        await WithPatience(2, async () => Expect.Equal(Lod.In("bytes").Whole(), (await Fetched(Url("drip/v2"))).Length));
    }

    public static async Task AHiddenPageIsNoSilentServer()
    {
        await WithPatience(1.4, async () =>
        {
            var fetching = Fetched(Url("slow/v2"));
            await Task.Yield();
            Thread.Sleep(1600); // no frame for so long
            await fetching;
        });
    }

    public static async Task WhatIsKeptIsCopiedIntoTheBrowsersStorage()
    {
        var collection = await Catalogue.OpenAsync($"{Facts.Server}/live");
        var flushes = Engine.Flushes;
        Expect.True(flushes > 0, "the catalogue is kept");
        await collection.DownloadAsync("bowl");
        Expect.Equal(flushes + 3, Engine.Flushes);
        await collection.DownloadAsync("bowl");
        Expect.Equal(flushes + 3, Engine.Flushes);
        collection.Clear("bowl");
        Expect.Equal(flushes + 6, Engine.Flushes);
    }
#else
    public static async Task WhoCallsFromAnotherThreadIsServedByTheMainOne()
    {
        var notebook = new Notebook();
        await Task.Run(() => UnityHttp.Fetch(Url("www/v2"), notebook, None));
        Expect.True(notebook.Threads.Count > 1 && notebook.Threads.All(each => each == Object.MainThread), "on the main thread");
        await Expect.Fault(CaptureFault.FileMissing, () => Task.Run(() => UnityHttp.Fetch(Url("www/nowhere"), notebook, None)));
    }

    public static void ItIsNotTheUsualWay() => Expect.True(Usual == Http.Fetch, "other platforms have threads");
#endif
}
