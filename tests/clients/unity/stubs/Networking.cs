// Stand-in for Unity's UnityWebRequest module, against real servers. As Unity documents it: all of it is of the main thread, a
// body comes in pieces of the handler's buffer, that of a refusal too, and a request is due to be disposed of. The network
// itself is the engine's or the browser's affair: here a thread of its own with a plain socket, none of .NET's pool.
using System;
using System.Collections.Generic;
using System.IO;
using System.Net.Sockets;
using System.Text;
using System.Threading;

namespace UnityEngine.Networking
{
    public partial class DownloadHandler : IDisposable
    {
        /// <summary>False aborts the request.</summary>
        protected virtual bool ReceiveData(byte[] data, int dataLength) => false;

        protected virtual void ReceiveContentLengthHeader(ulong contentLength)
        {
        }

        protected virtual void CompleteContent()
        {
        }

        public virtual void Dispose()
        {
        }

        internal void Announce(ulong length) => ReceiveContentLengthHeader(length);
        internal void Complete() => CompleteContent();
        internal virtual bool Pass(byte[] piece) => ReceiveData(piece, piece.Length);
    }

    public class DownloadHandlerScript : DownloadHandler
    {
        private readonly byte[] _buffer;

        public DownloadHandlerScript(byte[] preallocatedBuffer)
        {
            UnityEngine.Object.OnMainThread();
            _buffer = preallocatedBuffer;
        }

        /// <summary>The buffer is used again and again, and holds other bytes behind the new ones.</summary>
        internal override bool Pass(byte[] piece)
        {
            for (var from = 0; from < piece.Length; from += _buffer.Length)
            {
                var count = Math.Min(_buffer.Length, piece.Length - from);
                for (var place = 0; place < _buffer.Length; place++) _buffer[place] = 0xee;
                Array.Copy(piece, from, _buffer, 0, count);
                if (!ReceiveData(_buffer, count)) return false;
            }
            return true;
        }
    }

    public class DownloadHandlerBuffer : DownloadHandler
    {
        private readonly MemoryStream _all = new MemoryStream();

        public override byte[] data => _all.ToArray();

        protected override bool ReceiveData(byte[] data, int dataLength)
        {
            _all.Write(data, 0, dataLength);
            return true;
        }
    }

    public class UploadHandler
    {
    }

    /// <summary>Done in the frame after the request has ended, when all of its body was handed out.</summary>
    public sealed class UnityWebRequestAsyncOperation : AsyncOperation
    {
        internal UnityWebRequestAsyncOperation(UnityWebRequest request)
        {
            webRequest = request;
        }

        public UnityWebRequest webRequest { get; }
    }

    public sealed partial class UnityWebRequest : IDisposable
    {
        public const string kHttpVerbGET = "GET";

        public enum Result
        {
            InProgress,
            Success,
            ConnectionError,
            ProtocolError,
            DataProcessingError
        }

        /// <summary>Requests that nobody has disposed of, and all that were sent.</summary>
        public static int Open, Sent;

        private readonly Dictionary<string, string> _headers = new Dictionary<string, string>();
        private readonly DownloadHandler _handler;
        private readonly string _url;
        private readonly UnityWebRequestAsyncOperation _sending;
        private SynchronizationContext _main;
        private TcpClient _socket;
        private Result _result = Result.InProgress;
        private long _status;
        private string _error;
        private bool _disposed;

        public UnityWebRequest(string url, string method, DownloadHandler downloadHandler, UploadHandler uploadHandler)
        {
            UnityEngine.Object.OnMainThread();
            _url = url;
            _handler = downloadHandler;
            _sending = new UnityWebRequestAsyncOperation(this);
            Open++;
        }

        public string url => Own(_url);
        public Result result => Own(_result);
        public string error => Own(_error);

        /// <summary>0 before the server has answered.</summary>
        public long responseCode => Own(_status);

        public void SetRequestHeader(string name, string value)
        {
            if (Own(_main) != null) throw new InvalidOperationException("UnityWebRequest has already been sent and its headers cannot be altered");
            _headers[name] = value;
        }

        public UnityWebRequestAsyncOperation SendWebRequest()
        {
            if (Own(_main) != null) throw new InvalidOperationException("UnityWebRequest has already been sent");
            Sent++;
            _main = SynchronizationContext.Current;
            _socket = new TcpClient();
            new Thread(Browse) { IsBackground = true }.Start();
            return _sending;
        }

        public void Abort()
        {
            if (Own(_result) != Result.InProgress) return;
            _status = 0;
            End(Result.ConnectionError, "Request aborted");
        }

        public void Dispose()
        {
            UnityEngine.Object.OnMainThread();
            if (_disposed) return;
            if (_result == Result.InProgress) Abort();
            _disposed = true;
            _handler.Dispose();
            Open--;
        }

        /// <summary>Like the engine's object behind it, it is gone once it is disposed of.</summary>
        private T Own<T>(T value)
        {
            UnityEngine.Object.OnMainThread();
            if (_disposed) throw new ArgumentNullException("_unity_self");
            return value;
        }

        private void End(Result result, string error)
        {
            _result = result;
            _error = error;
            _socket?.Close();
            _main?.Post(_ => _sending.Finish(), null);
        }

        // On the network's thread.

        private void Browse()
        {
            try
            {
                var address = new Uri(_url);
                _socket.Connect(address.Host, address.Port);
                Answer(Ask(address));
            }
            catch (Exception fault) when (fault is IOException || fault is SocketException || fault is ObjectDisposedException)
            {
                OnMain(() => End(Result.ConnectionError, "Cannot connect to destination host"));
            }
        }

        private Stream Ask(Uri address)
        {
            var stream = _socket.GetStream();
            var text = new StringBuilder($"GET {address.PathAndQuery} HTTP/1.0\r\n");
            foreach (var header in _headers) text.Append($"{header.Key}: {header.Value}\r\n");
            var request = Encoding.ASCII.GetBytes(text + "\r\n");
            stream.Write(request, 0, request.Length);
            return stream;
        }

        private void Answer(Stream stream)
        {
            var status = long.Parse(Line(stream).Split(' ')[1]);
            OnMain(() => _status = status);
            var length = -1L;
            for (var line = Line(stream); line != ""; line = Line(stream))
            {
                if (line.StartsWith("Content-Length:", StringComparison.OrdinalIgnoreCase)) length = long.Parse(line.Substring(15));
            }
            if (length >= 0) OnMain(() => _handler.Announce((ulong)length));
            var come = Body(stream, length);
            if (come < length) OnMain(() => End(Result.ConnectionError, "Curl error 18: transfer closed with outstanding read data remaining"));
            else OnMain(() => Succeed(status));
        }

        private long Body(Stream stream, long length)
        {
            var piece = new byte[10_007];
            var come = 0L;
            int count;
            while (come != length && (count = stream.Read(piece, 0, piece.Length)) > 0)
            {
                var copy = new byte[count];
                Array.Copy(piece, copy, count);
                OnMain(() => Pass(copy));
                come += count;
            }
            return come;
        }

        private static string Line(Stream stream)
        {
            var line = new StringBuilder();
            int letter;
            while ((letter = stream.ReadByte()) != '\n')
            {
                if (letter < 0) throw new IOException("the answer ends in its head");
                line.Append((char)letter);
            }
            return line.ToString().TrimEnd('\r');
        }

        /// <summary>Nothing comes any more after the end.</summary>
        private void OnMain(Action act)
        {
            _main.Post(_ =>
            {
                if (_result == Result.InProgress) act();
            }, null);
        }

        private void Pass(byte[] piece)
        {
            if (!_handler.Pass(piece)) End(Result.ConnectionError, "Failed to receive data");
        }

        private void Succeed(long status)
        {
            _handler.Complete();
            if (status >= 400) End(Result.ProtocolError, $"HTTP/1.0 {status}");
            else End(Result.Success, null);
        }
    }
}
