// Stand-ins for what the engine has of memory, which only binary catalogues need. It is compiled with Unity's Addressables alone:
// our package and its tests are without pointers.
using System;
using System.Runtime.InteropServices;

namespace UnityEngine
{
    public static unsafe class HashUnsafeUtilities
    {
        public static void ComputeHash128(void* data, ulong dataSize, Hash128* hash) => throw NoStandIn.For("way to write binary catalogues");
    }
}

namespace Unity.Collections.LowLevel.Unsafe
{
    public static unsafe class UnsafeUtility
    {
        private const int ValueOf = 1; // the second word of a typed reference is where its value is

        public static int SizeOf<T>() where T : struct => Sizes<T>.Bytes;

        public static void* AddressOf<T>(ref T output) where T : struct
        {
            var reference = __makeref(output);
            return (void*)((IntPtr*)&reference)[ValueOf];
        }

        public static void MemCpy(void* destination, void* source, long size) => Buffer.MemoryCopy(source, destination, size, size);

        private static class Sizes<T>
        {
            public static readonly int Bytes = Marshal.SizeOf(typeof(T));
        }
    }
}
