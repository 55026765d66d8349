using System.Collections.Generic;
using System.Linq;

namespace Capture2vr
{
    /// <summary>Which level of detail to show, by the share of the view's height that the asset takes.</summary>
    public static class LodChoice
    {
        // Below these shares the next coarser level is fine enough: 25,000 and 5,000 triangles there come to some ten
        // pixels each on a headset of 2,000 lines. The viewer in the browser has the same.
        private static readonly float[] Shares = { 0.3f, 0.1f };
        private const float Narrowing = 3; // from level to level beyond these

        /// <summary>
        /// For each level, finest first, the share down to which it is shown; 0 for the last, which never vanishes.
        /// `levels` are the numbers of those that there are: a level that is missing leaves its range to the next.
        /// </summary>
        public static float[] Transitions(IReadOnlyList<int> levels)
        {
            return levels.Select((level, place) => place == levels.Count - 1 ? 0 : Below(level)).ToArray();
        }

        /// <summary>The place in `levels` of the one to show at a share of the view's height.</summary>
        public static int Place(IReadOnlyList<int> levels, float share)
        {
            var transitions = Transitions(levels);
            for (var place = 0; ; place++)
            {
                if (share >= transitions[place] || place == transitions.Length - 1) return place;
            }
        }

        private static float Below(int level)
        {
            var share = Shares[level < Shares.Length ? level : Shares.Length - 1];
            for (var each = Shares.Length; each <= level; each++) share /= Narrowing;
            return share;
        }
    }
}
