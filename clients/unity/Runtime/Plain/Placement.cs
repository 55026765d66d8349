using System;

namespace Capture2vr
{
    /// <summary>
    /// Where an asset stands and how large it may be made. Metres, Y up, left-handed as Unity's; an asset has its origin on
    /// the floor under it and its front towards +Z.
    /// </summary>
    public readonly struct Placement
    {
        public const float AheadM = 1.5f; // arm's length and a step: the whole of a person-sized thing is in view
        public const float EyeShare = 0.75f; // the middle of small things is at this share of the eyes' height
        public const float SmallM = 0.8f; // a thing lower than this would lie at one's feet
        public const float ClearanceM = 0.5f; // between the eyes and the near side of something large

        private const float SmallestM = 0.02f; // smaller is lost between the fingers
        private const float LargestM = 20f; // larger fills every room

        public readonly float X, Y, Z;

        /// <summary>Turn about Y, in radians, that brings the asset's front towards the viewer.</summary>
        public readonly float Yaw;

        private Placement(float x, float y, float z, float yaw)
        {
            X = x;
            Y = y;
            Z = z;
            Yaw = yaw;
        }

        /// <summary>On the floor ahead of a viewer, at true size; at a comfortable height where it is small.</summary>
        /// <param name="eye">of the viewer, x y z</param>
        /// <param name="gaze">where the viewer looks, x y z; only its direction along the floor counts</param>
        /// <param name="size">of the asset, x y z</param>
        /// <param name="floor">height of the floor</param>
        public static Placement Ahead(float[] eye, float[] gaze, float[] size, float floor)
        {
            Along(gaze, out var x, out var z);
            var away = Math.Max(AheadM, ClearanceM + Math.Max(size[0], size[2]) / 2);
            var lifted = floor + Math.Max(0, (eye[1] - floor) * EyeShare - size[1] / 2);
            var height = size[1] < SmallM ? lifted : floor;
            return new Placement(eye[0] + away * x, height, eye[2] + away * z, (float)Math.Atan2(-x, -z));
        }

        /// <summary>
        /// The factor to the true size that a wish may have: the asset neither vanishes nor swallows the room. True size
        /// itself is always allowed.
        /// </summary>
        /// <param name="longest">side of the asset at true size, in metres</param>
        public static float Scale(float wish, float longest)
        {
            if (float.IsNaN(wish) || !(longest > 0)) return 1;
            var least = Math.Min(1, SmallestM / longest);
            var most = Math.Max(1, LargestM / longest);
            return Math.Max(least, Math.Min(most, wish));
        }

        /// <summary>The gaze along the floor, of length 1; +Z for one straight up or down.</summary>
        private static void Along(float[] gaze, out float x, out float z)
        {
            var length = (float)Math.Sqrt(gaze[0] * gaze[0] + gaze[2] * gaze[2]);
            var upright = length < 1e-3f;
            x = upright ? 0 : gaze[0] / length;
            z = upright ? 1 : gaze[2] / length;
        }
    }
}
