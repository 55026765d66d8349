// Runs the public static methods of a class as tests and prints a line for each: "ok NAME" or "FAIL NAME: reason".
using System;
using System.Collections.Concurrent;
using System.Collections.Generic;
using System.IO;
using System.Linq;
using System.Reflection;
using System.Threading;
using System.Threading.Tasks;
using Capture2vr;

/// <summary>What the server is made of, as the Python side tells it.</summary>
public static class Facts
{
    public static object All;
    public static string Scratch;

    public static string Server => All.In("server").Text();

    public static string NewFolder()
    {
        var folder = Path.Combine(Scratch, Guid.NewGuid().ToString("N"));
        Directory.CreateDirectory(folder);
        return folder;
    }

    /// <summary>Ask the server for something that is only text.</summary>
    public static async Task<string> Ask(string path)
    {
        using (var memory = new MemoryStream())
        {
            await Http.Fetch($"{Server}/{path}", memory);
            return System.Text.Encoding.UTF8.GetString(memory.ToArray());
        }
    }
}

public static class Expect
{
    public static void True(bool holds, string what)
    {
        if (!holds) throw new Exception("not so: " + what);
    }

    public static void Equal<T>(T wanted, T found)
    {
        if (!EqualityComparer<T>.Default.Equals(wanted, found)) throw new Exception($"wanted {wanted}, found {found}");
    }

    public static void Near(double wanted, double found)
    {
        if (!(Math.Abs(wanted - found) < 1e-4)) throw new Exception($"wanted {wanted}, found {found}");
    }

    /// <summary>Waits for something that must come.</summary>
    public static async Task Comes(Func<bool> holds)
    {
        for (var left = 1000; !holds(); left--)
        {
            if (left == 0) throw new Exception("it does not come");
            await Task.Delay(5);
        }
    }

    public static void Lines(IEnumerable<string> wanted, IEnumerable<string> found) => Equal(string.Join("; ", wanted), string.Join("; ", found));

    public static T Throws<T>(Action act) where T : Exception
    {
        try
        {
            act();
        }
        catch (T fault)
        {
            return fault;
        }
        throw new Exception($"no {typeof(T).Name}");
    }

    public static async Task<CaptureFault> Fault(string code, Func<Task> act)
    {
        try
        {
            await act();
        }
        catch (CaptureFault fault)
        {
            Equal(code, fault.Code);
            return fault;
        }
        throw new Exception($"no {code}");
    }
}

/// <summary>A main thread as the engine has one: what awaits on it goes on on it.</summary>
public sealed class Pump : SynchronizationContext
{
    private readonly BlockingCollection<Action> _work = new BlockingCollection<Action>();

    public override void Post(SendOrPostCallback d, object state) => _work.Add(() => d(state));

    public static void Run(Func<Task> work)
    {
        var pump = new Pump();
        SetSynchronizationContext(pump);
        var task = work();
        task.ContinueWith(done => pump._work.Add(() => { }), TaskScheduler.Default);
        while (!task.IsCompleted) pump._work.Take()();
        SetSynchronizationContext(null);
        task.GetAwaiter().GetResult();
    }
}

public static class Program
{
    public static int Main(string[] arguments)
    {
        Facts.All = Json.Parse(File.ReadAllText(arguments[1]));
        Facts.Scratch = arguments[2];
        var tests = Type.GetType(arguments[0], true);
        var prepare = tests.GetMethod("Prepare", BindingFlags.Static | BindingFlags.NonPublic);
        var methods = tests.GetMethods(BindingFlags.Static | BindingFlags.Public | BindingFlags.DeclaredOnly);
        var failed = methods.Count(method => !Passes(method, prepare));
        return failed == 0 ? 0 : 1;
    }

    private static bool Passes(MethodInfo method, MethodInfo prepare)
    {
        try
        {
            Pump.Run(async () =>
            {
                if (prepare != null) await (Task)prepare.Invoke(null, null);
                if (method.Invoke(null, null) is Task task) await task;
            });
            Console.WriteLine("ok " + method.Name);
            return true;
        }
        catch (Exception fault)
        {
            var cause = (fault as TargetInvocationException)?.InnerException ?? fault;
            Console.WriteLine($"FAIL {method.Name}: {cause.ToString().Replace("\n", " | ")}");
            return false;
        }
    }
}
