using System;
using System.Diagnostics;
using System.Threading.Tasks;

namespace Capture2vr
{
    /// <summary>
    /// Runs work on other threads, and on the main thread where there are no others: in Unity's WebGL player. There Task.Run
    /// never begins, Task.Delay never ends, and what goes on after ConfigureAwait(false) is lost.
    /// </summary>
    internal static class Background
    {
#if UNITY_WEBGL && !UNITY_EDITOR
        public static readonly bool HasThreads = false;
#else
        public static readonly bool HasThreads = true;
#endif

        /// <summary>For ConfigureAwait: whether to come back to the thread that awaits. With one thread only, it must be.</summary>
        public static readonly bool ComesBack = !HasThreads;

        private const int SliceMs = 4; // of a frame, which has 8 to 16

        private static readonly Stopwatch Slice = Stopwatch.StartNew();
        private static Task _frame = Task.CompletedTask;

        /// <summary>Run work on another thread; without threads, from the next frame on. So the caller never waits for it.</summary>
        public static Task<T> Run<T>(Func<Task<T>> work) => HasThreads ? Task.Run(work) : RunHere(work);

        /// <summary>Run work that has no result.</summary>
        public static Task Run(Func<Task> work) => HasThreads ? Task.Run(work) : RunHere(work);

        /// <summary>Wait; without threads, for at least one frame.</summary>
        public static Task Delay(int milliseconds) => HasThreads ? Task.Delay(milliseconds) : Frames(milliseconds);

        /// <summary>
        /// Let a frame pass where work on the main thread has taken its share of this one. Long work awaits it between its
        /// pieces; all that do share what a frame has. Does nothing where there are threads.
        /// </summary>
        public static Task Pause()
        {
            if (HasThreads || Slice.ElapsedMilliseconds < SliceMs) return Task.CompletedTask;
            if (_frame.IsCompleted) _frame = NextSlice();
            return _frame;
        }

        private static async Task<T> RunHere<T>(Func<Task<T>> work)
        {
            await Task.Yield(); // the engine goes on with it in its next frame
            return await work();
        }

        private static async Task RunHere(Func<Task> work)
        {
            await Task.Yield();
            await work();
        }

        private static async Task Frames(int milliseconds)
        {
            var watch = Stopwatch.StartNew();
            do await Task.Yield();
            while (watch.ElapsedMilliseconds < milliseconds);
        }

        private static async Task NextSlice()
        {
            await Task.Yield();
            Slice.Restart();
        }
    }
}
