using System;
using System.IO;
using System.Security.Cryptography;
using System.Threading.Tasks;

namespace Capture2vr
{
    /// <summary>
    /// Passes on what is written to it, hashes it on the way and refuses more than was announced. So a download is read
    /// once, and a server that never stops sending cannot fill the device. Where there is one thread only, what was written
    /// is hashed at the end instead: data comes in bursts there, and a frame must not wait for the hashing of one.
    /// </summary>
    internal sealed class HashingStream : Stream
    {
        private readonly Stream _inner;
        private readonly long _most;
        private readonly Action<long> _told;
        private readonly SHA256 _sha = Background.HasThreads ? SHA256.Create() : null;
        private long _written;

        public HashingStream(Stream inner, long most, Action<long> told)
        {
            _inner = inner;
            _most = most;
            _told = told;
        }

        public long Written => _written;

        /// <summary>The hash of everything written, to a stream that can be read too; it is then closed for more.</summary>
        public async Task<string> FinishAsync()
        {
            if (_sha != null)
            {
                _sha.TransformFinalBlock(new byte[0], 0, 0);
                return Sha256.Hex(_sha.Hash);
            }
            _inner.Position = 0;
            return await Sha256.OfAsync(_inner).ConfigureAwait(Background.ComesBack);
        }

        public override void Write(byte[] buffer, int offset, int count)
        {
            if (_written + count > _most)
            {
                throw new CaptureFault(CaptureFault.FileChanged, $"the server sends more than the {_most:N0} bytes it should");
            }
            _inner.Write(buffer, offset, count);
            _sha?.TransformBlock(buffer, offset, count, null, 0);
            _written += count;
            _told(_written);
        }

        public override void Flush() => _inner.Flush();

        protected override void Dispose(bool disposing)
        {
            if (disposing) _sha?.Dispose();
            base.Dispose(disposing);
        }

        public override bool CanRead => false;
        public override bool CanSeek => false;
        public override bool CanWrite => true;
        public override long Length => _written;
        public override long Position { get => _written; set => throw new NotSupportedException(); }
        public override int Read(byte[] buffer, int offset, int count) => throw new NotSupportedException();
        public override long Seek(long offset, SeekOrigin origin) => throw new NotSupportedException();
        public override void SetLength(long value) => throw new NotSupportedException();
    }
}
