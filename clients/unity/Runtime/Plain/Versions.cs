using System;
using System.Collections.Generic;
using System.Globalization;
using System.IO;
using System.Linq;

namespace Capture2vr
{
    /// <summary>
    /// The highest version that this device has seen of each thing, in a file of lines "version name". Whoever serves an
    /// older one, a stale cache or an attacker, is refused. Safe from all threads.
    /// </summary>
    public sealed class Versions
    {
        private readonly object _lock = new object();
        private readonly string _path;
        private readonly Dictionary<string, long> _highest;

        public Versions(string path)
        {
            _path = path;
            _highest = Read(path);
        }

        /// <summary>Throws CaptureFault CATALOGUE_OLDER for an older version than the highest; keeps a higher one.</summary>
        public void Check(string name, long version)
        {
            lock (_lock)
            {
                var known = _highest.TryGetValue(name, out var highest);
                if (known && version < highest)
                {
                    throw new CaptureFault(CaptureFault.CatalogueOlder,
                        $"{name}: version {version} was offered, but this device has seen version {highest}",
                        "The server or a cache on the way is out of date; try again later");
                }
                if (known && version == highest) return;
                _highest[name] = version;
                Write();
            }
        }

        /// <summary>
        /// Replaced as a whole: a crash leaves the old file or the new one. A full disk is no fault: what the device has can be shown,
        /// and this run remembers.
        /// </summary>
        private void Write()
        {
            var part = _path + ".part";
            try
            {
                File.WriteAllLines(part, _highest.Select(each => $"{each.Value} {each.Key}"));
                Storage.Replace(part, _path);
            }
            catch (Exception fault) when (fault is IOException || fault is UnauthorizedAccessException)
            {
                // The next version that is seen writes all of them.
            }
        }

        /// <summary>Lines that make no sense are left out: better to forget one version than to show nothing at all.</summary>
        private static Dictionary<string, long> Read(string path)
        {
            var found = new Dictionary<string, long>();
            if (!File.Exists(path)) return found;
            foreach (var line in File.ReadAllLines(path))
            {
                var space = line.IndexOf(' ');
                if (space < 0) continue;
                var digits = line.Substring(0, space);
                var whole = long.TryParse(digits, NumberStyles.None, CultureInfo.InvariantCulture, out var version);
                if (whole) found[line.Substring(space + 1)] = version;
            }
            return found;
        }
    }
}
