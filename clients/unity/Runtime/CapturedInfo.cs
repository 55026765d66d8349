using UnityEngine;

namespace Capture2vr
{
    /// <summary>On the object of every asset, and so on clones of a prefab: what one needs to know of it.</summary>
    public sealed class CapturedInfo : MonoBehaviour
    {
        // Serialized, since only such fields are copied into clones.
        [SerializeField] private int version;
        [SerializeField] private Bounds box;

        public int Version => version;

        /// <summary>Where it is about its origin, in metres at true size.</summary>
        public Bounds Box => box;

        /// <summary>Sides in metres at true size.</summary>
        public Vector3 Size => box.size;

        internal void Tell(int itsVersion, Bounds itsBox)
        {
            version = itsVersion;
            box = itsBox;
        }
    }
}
