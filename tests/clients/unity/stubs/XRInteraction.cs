// Stand-in for com.unity.xr.interaction.toolkit 3, as far as the samples use it.
using System;
using UnityEngine.Events;

namespace UnityEngine.Events
{
    public delegate void UnityAction<T>(T argument);

    public abstract class UnityEvent<T>
    {
        private event UnityAction<T> Listeners = delegate { };

        public void AddListener(UnityAction<T> call) => Listeners += call;
        public void Invoke(T argument) => Listeners(argument);
    }
}

namespace UnityEngine.XR.Interaction.Toolkit
{
    public sealed class SelectEnterEventArgs
    {
    }

    public sealed class SelectEnterEvent : UnityEvent<SelectEnterEventArgs>
    {
    }
}

namespace UnityEngine.XR.Interaction.Toolkit.Interactables
{
    /// <summary>Takes the colliders that are there when it begins; without one nobody can point at it.</summary>
    public sealed class XRSimpleInteractable : MonoBehaviour
    {
        public SelectEnterEvent selectEntered { get; } = new SelectEnterEvent();

        public void Select()
        {
            if (GetComponent<Collider>() == null) throw new InvalidOperationException("it has no collider");
            selectEntered.Invoke(new SelectEnterEventArgs());
        }
    }

    public sealed class XRGrabInteractable : MonoBehaviour
    {
        public bool useDynamicAttach { get; set; }
        public bool throwOnDetach { get; set; } = true;
    }
}
