using System.Threading.Tasks;

namespace Capture2vr
{
    /// <summary>A file on its way to the device, possibly for several users.</summary>
    public sealed class Download
    {
        internal Download(long size)
        {
            Size = size;
        }

        /// <summary>The path of the file. Faults with CaptureFault.</summary>
        public Task<string> Task { get; internal set; }

        /// <summary>In bytes, or -1 where it is not known.</summary>
        public long Size { get; }

        /// <summary>Bytes so far; 0 for a file that was on the device.</summary>
        public long Received { get; internal set; }

        internal int Sharers { get; set; }
    }
}
