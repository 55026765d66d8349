// What the engine does before the first scene, for the parts of the package that ask for it.
using System;
using System.Reflection;
using System.Threading;
using Capture2vr;

public static class Engine
{
    /// <summary>How often files were to be copied into the browser's storage; always 0 elsewhere.</summary>
    public static int Flushes { get; private set; }

    public static void Start()
    {
        UnityEngine.Object.MainThread = Thread.CurrentThread;
        Static(typeof(UnityHttp), "Remember").Invoke(null, null);
#if UNITY_WEBGL
        var storage = typeof(FileCache).Assembly.GetType("Capture2vr.Storage");
        Action flush = () => Flushes++;
        storage.GetField("_flush", BindingFlags.Static | BindingFlags.NonPublic).SetValue(null, flush);
#endif
    }

    private static MethodInfo Static(Type type, string name) => type.GetMethod(name, BindingFlags.Static | BindingFlags.NonPublic);
}
