using System;
using System.Collections.Generic;
using System.IO;
using System.Linq;
using System.Threading.Tasks;

namespace Capture2vr
{
    /// <summary>
    /// Files on the device, each named by the SHA-256 of what it holds, so that a name never means other bytes.
    ///
    /// Every load hashes the file anew and fetches it again where it is damaged. What nobody uses goes when the limit is
    /// passed, the longest unused first. One cache per folder; safe from all threads.
    /// </summary>
    public sealed class FileCache
    {
        /// <summary>Most bytes of a file whose size nobody has told.</summary>
        public const long UntoldSize = 64L << 20;

        private const string Part = ".part";

        private readonly object _lock = new object();
        private readonly string _folder;
        private readonly long _limit;
        private readonly Fetch _fetch;
        private readonly Dictionary<string, Download> _underWay = new Dictionary<string, Download>();
        private readonly RefCounts _users = new RefCounts();

        // Order of use within this run: clocks of headsets jump, and file systems tell times as roughly as they like.
        private readonly Dictionary<string, long> _lastUse = new Dictionary<string, long>();
        private long _uses;
        private long _bytes = -1; // of all files, or more where some were removed by others; -1: not counted yet

        /// <param name="limit">bytes that all files together may take; those in use stay whatever they take</param>
        public FileCache(string folder, long limit, Fetch fetch)
        {
            _folder = folder;
            _limit = limit;
            _fetch = fetch;
            Directory.CreateDirectory(folder);
            // An app that was killed while it downloaded leaves these behind; nobody else writes here.
            foreach (var path in Directory.GetFiles(folder, "*" + Part)) File.Delete(path);
        }

        /// <summary>Where a file is, once it is there.</summary>
        public string PathOf(string sha256) => Path.Combine(_folder, sha256);

        /// <summary>Bytes of all files.</summary>
        public long Bytes => Files().Sum(file => file.Length);

        /// <summary>Whether a file is here, by its name and its size: its bytes are looked at when it is loaded.</summary>
        public bool Has(string sha256, long size)
        {
            var file = new FileInfo(PathOf(sha256));
            return file.Exists && (size < 0 || file.Length == size);
        }

        /// <summary>Take a file off the device. False where somebody uses it, or it is not here.</summary>
        public bool Remove(string sha256)
        {
            lock (_lock)
            {
                if (_users.Held(sha256) || !File.Exists(PathOf(sha256))) return false;
                File.Delete(PathOf(sha256));
                Storage.Flush();
                return true;
            }
        }

        /// <summary>
        /// The file with this hash, from the device or else from the address; loads of the same file at the same time
        /// download it once. `size` in bytes, or -1 where it is not known. Where it succeeds, Release is due once.
        /// </summary>
        public Download Load(string url, string sha256, long size)
        {
            if (!Sha256.IsHash(sha256)) throw new ArgumentException($"{sha256} is no SHA-256");
            lock (_lock)
            {
                _users.Take(sha256);
                _lastUse[sha256] = ++_uses;
                if (!_underWay.TryGetValue(sha256, out var download))
                {
                    download = _underWay[sha256] = new Download(size);
                    download.Task = Background.Run(() => Obtain(url, sha256, size, download));
                }
                download.Sharers += 1;
                return download;
            }
        }

        /// <summary>Say that a loaded file is not used any more. It stays until its room is needed.</summary>
        public void Release(string sha256)
        {
            lock (_lock)
            {
                _users.Give(sha256);
            }
        }

        private async Task<string> Obtain(string url, string sha256, long size, Download download)
        {
            var obtained = false;
            try
            {
                var path = PathOf(sha256);
                var whole = await IsWhole(path, sha256).ConfigureAwait(Background.ComesBack);
                if (!whole) await Fetch(url, sha256, size, download).ConfigureAwait(Background.ComesBack);
                Storage.Touch(path);
                obtained = true;
                return path;
            }
            finally
            {
                End(sha256, download, obtained);
            }
        }

        /// <summary>Who comes from now on starts anew. Nobody releases what failed, so its users are taken off here.</summary>
        private void End(string sha256, Download download, bool obtained)
        {
            lock (_lock)
            {
                _underWay.Remove(sha256);
                if (obtained) return;
                for (var each = 0; each < download.Sharers; each++) _users.Give(sha256);
            }
        }

        private static async Task<bool> IsWhole(string path, string sha256)
        {
            try
            {
                using (var file = File.OpenRead(path))
                {
                    if (await Sha256.OfAsync(file).ConfigureAwait(Background.ComesBack) == sha256) return true;
                }
                File.Delete(path);
            }
            catch (FileNotFoundException)
            {
                // The usual case on a first visit.
            }
            catch (Exception fault) when (fault is IOException || fault is UnauthorizedAccessException)
            {
                // What cannot be read is fetched again; where it cannot be replaced either, that says why.
            }
            return false;
        }

        private async Task Fetch(string url, string sha256, long size, Download download)
        {
            var part = PathOf(sha256) + "." + Guid.NewGuid().ToString("N") + Part;
            long come;
            try
            {
                Directory.CreateDirectory(_folder); // systems clear the caches of apps while these run
                come = await FetchTo(part, url, sha256, size, download).ConfigureAwait(Background.ComesBack);
                // A name appears only with all its bytes on the disk: a crash before this leaves a part, which is swept.
                File.Move(part, PathOf(sha256));
            }
            catch (Exception fault) when (fault is IOException || fault is UnauthorizedAccessException)
            {
                throw new CaptureFault(CaptureFault.StorageFailed, $"{url} cannot be kept on this device: {fault.Message}",
                    "Free some storage", fault);
            }
            finally
            {
                Discard(part);
            }
            Evict(come);
            Storage.Flush();
        }

        private async Task<long> FetchTo(string part, string url, string sha256, long size, Download download)
        {
            using (var file = new FileStream(part, FileMode.CreateNew))
            using (var hashing = new HashingStream(file, size < 0 ? UntoldSize : size, told => download.Received = told))
            {
                await _fetch(url, hashing).ConfigureAwait(Background.ComesBack);
                file.Flush(true);
                if (await hashing.FinishAsync().ConfigureAwait(Background.ComesBack) == sha256) return hashing.Written;
                throw new CaptureFault(CaptureFault.FileChanged,
                    $"{url}: its {hashing.Written:N0} bytes do not have the hash of the catalogue",
                    "It was damaged on the way or tampered with, and is not shown");
            }
        }

        private static void Discard(string path)
        {
            try
            {
                File.Delete(path);
            }
            catch (IOException)
            {
                // The next start sweeps it; what went wrong before this matters more.
            }
        }

        /// <summary>Counted along: a catalogue of many shards would else have all files listed for each of them.</summary>
        /// <param name="come">bytes of the file that has just come</param>
        private void Evict(long come)
        {
            lock (_lock)
            {
                _bytes = _bytes < 0 ? Bytes : _bytes + come;
                if (_bytes <= _limit) return;
                var files = Files().OrderBy(LastUse).ThenBy(file => file.LastWriteTimeUtc).ToList();
                _bytes = files.Sum(file => file.Length);
                foreach (var file in files.Where(file => !_users.Held(file.Name)))
                {
                    if (_bytes <= _limit) return;
                    _bytes -= file.Length;
                    file.Delete();
                }
            }
        }

        /// <summary>0 for files of earlier runs, which are therefore the first to go, by the time that they bear.</summary>
        private long LastUse(FileInfo file)
        {
            _lastUse.TryGetValue(file.Name, out var use);
            return use;
        }

        private IEnumerable<FileInfo> Files()
        {
            return new DirectoryInfo(_folder).GetFiles().Where(file => Sha256.IsHash(file.Name));
        }
    }
}
