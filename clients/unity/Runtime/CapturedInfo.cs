using UnityEngine;

namespace Capture2vr
{
    /// <summary>On the prefab of every asset, and so on its clones: what one needs to know of it.</summary>
    public sealed class CapturedInfo : MonoBehaviour
    {
        // Serialized, since only such fields are copied into clones.
        [SerializeField] private int version;
        [SerializeField] private Vector3 size;

        public int Version => version;

        /// <summary>Sides in metres at true size.</summary>
        public Vector3 Size => size;

        internal void Tell(int itsVersion, Vector3 itsSize)
        {
            version = itsVersion;
            size = itsSize;
        }
    }
}
