using System;
using System.Collections.Generic;

namespace Capture2vr
{
    /// <summary>How many users each thing has. Not safe by itself: its owner holds a lock.</summary>
    public sealed class RefCounts
    {
        private readonly Dictionary<string, int> _counts = new Dictionary<string, int>();

        public bool Held(string name) => _counts.ContainsKey(name);

        public void Take(string name)
        {
            _counts.TryGetValue(name, out var count);
            _counts[name] = count + 1;
        }

        /// <summary>
        /// Whether that was the last user. Throws for one too many: to go on would take the thing from somebody who still
        /// uses it.
        /// </summary>
        public bool Give(string name)
        {
            if (!_counts.TryGetValue(name, out var count))
            {
                throw new InvalidOperationException($"{name} was released more often than it was loaded");
            }
            if (count > 1)
            {
                _counts[name] = count - 1;
                return false;
            }
            return _counts.Remove(name);
        }
    }
}
