// Stand-in for com.unity.xr.interaction.toolkit 3, as far as the sample uses it.
namespace UnityEngine.XR.Interaction.Toolkit.Interactables
{
    public sealed class XRGrabInteractable : MonoBehaviour
    {
        public bool useDynamicAttach { get; set; }
        public bool throwOnDetach { get; set; } = true;
    }
}
