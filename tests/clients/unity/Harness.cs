// Runs the public static methods of a class as tests and prints a line for each: "ok NAME" or "FAIL NAME: reason".
using System;
using System.Collections.Generic;
using System.Diagnostics;
using System.IO;
using System.Linq;
using System.Net.Sockets;
using System.Reflection;
using System.Text;
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

    /// <summary>
    /// Ask the server for something that is only text. Over a plain socket, which needs none of the threads that tests of the
    /// WebGL player go without.
    /// </summary>
    public static string Ask(string path)
    {
        var server = new Uri(Server);
        using (var socket = new TcpClient(server.Host, server.Port))
        using (var stream = socket.GetStream())
        {
            var request = Encoding.ASCII.GetBytes($"GET /{path} HTTP/1.0\r\n\r\n");
            stream.Write(request, 0, request.Length);
            var answer = new StreamReader(stream).ReadToEnd();
            return answer.Substring(answer.IndexOf("\r\n\r\n", StringComparison.Ordinal) + 4);
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
        for (var waited = Stopwatch.StartNew(); !holds(); await Task.Yield())
        {
            if (waited.Elapsed > Pump.Patience) throw new TimeoutException("it does not come");
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
        var fault = await Fault(act);
        Equal(code, fault.Code);
        return fault;
    }

    public static async Task<CaptureFault> Fault(Func<Task> act)
    {
        try
        {
            await act();
        }
        catch (CaptureFault fault)
        {
            return fault;
        }
        throw new Exception("no fault");
    }
}

/// <summary>
/// A main thread as the engine has one: what awaits on it goes on on it, in the next frame where it was posted in this one.
/// </summary>
public sealed class Pump : SynchronizationContext
{
    /// <summary>Nothing here takes so long, on however crowded a machine: what does waits for something that never comes.</summary>
    public static readonly TimeSpan Patience = TimeSpan.FromSeconds(60);

    private readonly Queue<Action> _posted = new Queue<Action>();

    /// <summary>How many frames have begun.</summary>
    public static int Frames { get; private set; }

    /// <summary>What else the engine does in each frame.</summary>
    public static Action InEachFrame { get; set; } = () => { };

    public override void Post(SendOrPostCallback d, object state)
    {
        lock (_posted) _posted.Enqueue(() => d(state));
    }

    public static void Run(Func<Task> work)
    {
        var pump = new Pump();
        SetSynchronizationContext(pump);
        var task = work();
        for (var waited = Stopwatch.StartNew(); !task.IsCompleted; pump.Frame())
        {
            if (waited.Elapsed > Patience) throw new TimeoutException("it hangs");
        }
        SetSynchronizationContext(null);
        task.GetAwaiter().GetResult();
    }

    /// <summary>A millisecond or more: what waits for frames must not take all of a core.</summary>
    private void Frame()
    {
        Frames++;
        Thread.Sleep(1);
        Action[] due;
        lock (_posted)
        {
            due = _posted.ToArray();
            _posted.Clear();
        }
        foreach (var each in due) each();
        InEachFrame();
    }
}

/// <summary>.NET as Unity's WebGL player has it: its thread pool runs nothing, and so no timer and no socket of its own.</summary>
public static class SingleThread
{
    private const int Spare = 64;

    public static void Begin()
    {
        var all = Environment.ProcessorCount;
        ThreadPool.SetMinThreads(all, all);
        if (!ThreadPool.SetMaxThreads(all, all)) throw new Exception("the pool cannot be limited");
        var busy = new CountdownEvent(all);
        for (var each = 0; each < all; each++) ThreadPool.QueueUserWorkItem(_ => Occupy(busy));
        busy.Wait();
        // Mono begins a thread more at times, limit or not: it finds these first.
        for (var each = 0; each < Spare; each++) ThreadPool.QueueUserWorkItem(_ => Sleep());
    }

    private static void Occupy(CountdownEvent busy)
    {
        busy.Signal();
        Sleep();
    }

    private static void Sleep()
    {
        while (true) Thread.Sleep(Timeout.Infinite); // Mono ends it early at times
    }
}

public static class Program
{
    public static int Main(string[] arguments)
    {
        Facts.All = Json.Parse(File.ReadAllText(arguments[1]));
        Facts.Scratch = arguments[2];
#if UNITY_WEBGL
        SingleThread.Begin();
#endif
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
                prepare?.Invoke(null, null);
                if (method.Invoke(null, null) is Task task) await task;
            });
            Console.WriteLine("ok " + method.Name);
            return true;
        }
        catch (Exception fault)
        {
            var cause = (fault as TargetInvocationException)?.InnerException ?? fault;
            Console.WriteLine($"FAIL {method.Name}: {cause.ToString().Replace("\n", " | ")}");
            if (cause is TimeoutException) Environment.Exit(1); // others would wait for the same
            return false;
        }
    }
}
