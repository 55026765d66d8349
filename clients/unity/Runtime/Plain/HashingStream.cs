using System;
using System.IO;
using System.Security.Cryptography;

namespace Capture2vr
{
    /// <summary>
    /// Passes on what is written to it, hashes it on the way and refuses more than was announced. So a download is read
    /// once, and a server that never stops sending cannot fill the device.
    /// </summary>
    internal sealed class HashingStream : Stream
    {
        private readonly Stream _inner;
        private readonly long _most;
        private readonly Action<long> _told;
        private readonly SHA256 _sha = SHA256.Create();
        private long _written;

        public HashingStream(Stream inner, long most, Action<long> told)
        {
            _inner = inner;
            _most = most;
            _told = told;
        }

        public long Written => _written;

        /// <summary>The hash of everything written; the stream is then closed for more.</summary>
        public string Finish()
        {
            _sha.TransformFinalBlock(new byte[0], 0, 0);
            return Sha256.Hex(_sha.Hash);
        }

        public override void Write(byte[] buffer, int offset, int count)
        {
            if (_written + count > _most)
            {
                throw new CaptureFault(CaptureFault.FileChanged, $"the server sends more than the {_most:N0} bytes it should");
            }
            _inner.Write(buffer, offset, count);
            _sha.TransformBlock(buffer, offset, count, null, 0);
            _written += count;
            _told(_written);
        }

        public override void Flush() => _inner.Flush();

        protected override void Dispose(bool disposing)
        {
            if (disposing) _sha.Dispose();
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
