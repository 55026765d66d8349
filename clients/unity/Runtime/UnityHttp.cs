using System;
using System.Collections.Generic;
using System.Diagnostics;
using System.IO;
using System.Runtime.ExceptionServices;
using System.Threading;
using System.Threading.Tasks;
using UnityEngine;
using UnityEngine.Networking;

namespace Capture2vr
{
    /// <summary>
    /// Fetches by UnityWebRequest, which in a browser is the only way. It is of the main thread: whoever calls from another
    /// one waits until the engine's next frame, and what comes is written on the main thread.
    /// </summary>
    public static class UnityHttp
    {
        private const int PieceBytes = 1 << 16;

        private static SynchronizationContext _main;
        private static Thread _thread;

        /// <summary>Write what is at an address into a stream, while it comes. Throws CaptureFault as Http.Fetch does.</summary>
        public static Task Fetch(string url, Stream into, IReadOnlyDictionary<string, string> headers)
        {
            if (Thread.CurrentThread == _thread) return Send(url, into, headers);
            var done = new TaskCompletionSource<bool>();
            _main.Post(_ => Forward(Send(url, into, headers), done), null);
            return done.Task;
        }

        /// <summary>The engine calls it on its main thread, before the first scene.</summary>
        [RuntimeInitializeOnLoadMethod(RuntimeInitializeLoadType.BeforeSceneLoad)]
        private static void Remember()
        {
            _main = SynchronizationContext.Current;
            _thread = Thread.CurrentThread;
        }

        private static async void Forward(Task task, TaskCompletionSource<bool> done)
        {
            try
            {
                await task;
                done.SetResult(true);
            }
            catch (Exception fault)
            {
                done.SetException(fault);
            }
        }

        private static async Task Send(string url, Stream into, IReadOnlyDictionary<string, string> headers)
        {
            var body = new Body(into);
            using (var request = new UnityWebRequest(url, UnityWebRequest.kHttpVerbGET, body, null))
            {
                body.Request = request;
                foreach (var header in headers) request.SetRequestHeader(header.Key, header.Value);
                await Finish(request, request.SendWebRequest(), body);
                body.Fault?.Throw();
                if (request.responseCode > 0) HttpFaults.Check(url, request.responseCode);
                if (request.result != UnityWebRequest.Result.Success) throw HttpFaults.Unreachable(url, request.error);
            }
        }

        /// <summary>UnityWebRequest's own timeout is for the whole of a download, which may take any time.</summary>
        private static async Task Finish(UnityWebRequest request, UnityWebRequestAsyncOperation sending, Body body)
        {
            var frame = Stopwatch.StartNew();
            while (!sending.isDone)
            {
                await Task.Yield();
                body.Wait(frame.Elapsed);
                frame.Restart();
                if (body.Waited > HttpFaults.Patience)
                {
                    request.Abort();
                    throw HttpFaults.Silent(request.url);
                }
            }
        }

        /// <summary>Passes a body on in pieces, of which there is one at a time.</summary>
        private sealed class Body : DownloadHandlerScript
        {
            // A hidden page and a headset that is put down have no frames: what came meanwhile is told in the next one.
            private static readonly TimeSpan LongestFrame = TimeSpan.FromSeconds(0.5);

            private readonly Stream _into;

            public Body(Stream into) : base(new byte[PieceBytes])
            {
                _into = into;
            }

            public UnityWebRequest Request { private get; set; }

            /// <summary>Why the stream did not take it, or null.</summary>
            public ExceptionDispatchInfo Fault { get; private set; }

            /// <summary>How long nothing has come.</summary>
            public TimeSpan Waited { get; private set; }

            public void Wait(TimeSpan frame) => Waited += frame < LongestFrame ? frame : LongestFrame;

            private bool IsWanted => Request.responseCode <= 0 || HttpFaults.IsSuccess(Request.responseCode);

            /// <summary>False ends the request. The page that tells of a fault is a body too, and none to be kept.</summary>
            protected override bool ReceiveData(byte[] data, int dataLength)
            {
                Waited = TimeSpan.Zero;
                try
                {
                    if (IsWanted) _into.Write(data, 0, dataLength);
                    return true;
                }
                catch (Exception fault)
                {
                    Fault = ExceptionDispatchInfo.Capture(fault); // through the engine's own code it must not go
                    return false;
                }
            }
        }
    }
}
