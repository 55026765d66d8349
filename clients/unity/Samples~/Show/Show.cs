using Capture2vr;
using UnityEngine;

/// <summary>Opens a collection and stands one of its assets ahead of the viewer. Put it on an empty object.</summary>
public sealed class Show : MonoBehaviour
{
    [SerializeField] private string baseUrl = "https://cdn.example";
    [SerializeField] private string collection = "default";
    [SerializeField] private string publicKey = "";
    [SerializeField] private string key = "dress";

    private async void Start()
    {
        try
        {
            await Catalogue.OpenAsync(baseUrl, collection, publicKey == "" ? new string[0] : new[] { publicKey });
        }
        catch (CaptureFault fault)
        {
            Debug.LogError(fault.Message, this);
            return;
        }
        var asset = new GameObject(key).AddComponent<CapturedAsset>();
        asset.Key = key;
        asset.Shown += shown => Debug.Log($"{shown.Key}, version {shown.Info.Version}");
        asset.Failed += fault => Debug.LogError($"{key}: {fault.Message}", this);
    }
}
