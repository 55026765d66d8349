using Capture2vr;
using UnityEngine;
using UnityEngine.XR.Interaction.Toolkit.Interactables;

/// <summary>
/// Makes an asset one that hands and controllers can take up, carry and put down. Put it beside a CapturedAsset, in a scene
/// with an XR Interaction Manager; needs XR Interaction Toolkit 3.
/// </summary>
[RequireComponent(typeof(CapturedAsset))]
public sealed class Grab : MonoBehaviour
{
    private void Awake()
    {
        var asset = GetComponent<CapturedAsset>();
        asset.HasBoxCollider = true;
        asset.Shown += _ => MakeGrabbable();
    }

    /// <summary>Once its collider is there: the interactable looks for colliders when it begins.</summary>
    private void MakeGrabbable()
    {
        if (GetComponent<XRGrabInteractable>() != null) return;
        var body = gameObject.AddComponent<Rigidbody>();
        body.isKinematic = true; // a captured thing has no weight that anybody knows: it stays where it is let go
        body.useGravity = false;
        var grab = gameObject.AddComponent<XRGrabInteractable>();
        grab.useDynamicAttach = true; // held where it was touched, instead of by its origin
        grab.throwOnDetach = false;
    }
}
