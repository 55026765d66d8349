using System;
using System.IO;
#if UNITY_WEBGL && !UNITY_EDITOR
using System.Runtime.InteropServices;
#endif

namespace Capture2vr
{
    /// <summary>
    /// Puts files where they belong so that they outlive the app. In a browser the files are in memory, and a copy of them in
    /// its IndexedDB is written when somebody asks for it.
    /// </summary>
    internal static class Storage
    {
#if UNITY_WEBGL && !UNITY_EDITOR
        /// <summary>In Plugins/WebGL/Capture2vr.jslib.</summary>
        [DllImport("__Internal")]
        private static extern void Capture2vrFlush();

        private static Action _flush = () => Capture2vrFlush();

        /// <summary>Copy what has changed into the browser's storage. Comes back at once; the browser goes on with it.</summary>
        public static void Flush() => _flush();

        /// <summary>No time is written: the copy of a file whose time has changed would be written anew, however long it is.</summary>
        public static void Touch(string path)
        {
        }

        /// <summary>Put a file in the place of another. Nothing comes between: the copy is made of what stands there afterwards.</summary>
        public static void Replace(string part, string path)
        {
            File.Delete(path);
            File.Move(part, path);
            Flush();
        }
#else
        /// <summary>Nothing to do: files are on the disk.</summary>
        public static void Flush()
        {
        }

        /// <summary>Say that a file was used now.</summary>
        public static void Touch(string path)
        {
            try
            {
                File.SetLastWriteTimeUtc(path, DateTime.UtcNow);
            }
            catch (IOException)
            {
                // Only the order of eviction after the next start suffers.
            }
        }

        /// <summary>Put a file in the place of another: a crash leaves the old one or the new one.</summary>
        public static void Replace(string part, string path)
        {
            if (File.Exists(path)) File.Replace(part, path, null);
            else File.Move(part, path);
        }
#endif
    }
}
