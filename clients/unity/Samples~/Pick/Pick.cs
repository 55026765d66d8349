using System.Collections.Generic;
using System.Linq;
using System.Threading.Tasks;
using Capture2vr;
using UnityEngine;
using UnityEngine.XR.Interaction.Toolkit.Interactables;

/// <summary>
/// A wall with the pictures of a collection: point at one and pull the trigger, or pinch, and the thing stands ahead. Above
/// them are the labels to choose by, below the pages. Put it on an empty object where the wall is to stand, its blue axis
/// away from the viewer, in a scene with an XR Interaction Manager; needs XR Interaction Toolkit 3.
/// </summary>
public sealed class Pick : MonoBehaviour
{
    private const int Columns = 4;
    private const int Lines = 3;
    private const int MostLabels = 6; // the most frequent ones
    private const float PictureSize = 0.3f; // metres
    private const float Step = 0.42f; // from one picture to the next, with room for the name
    private const float LetterSize = 0.006f; // 4 cm high, which is easily read from 1.5 m

    [SerializeField] private string baseUrl = "https://cdn.example";
    [SerializeField] private string collection = "default";
    [SerializeField] private string publicKey = "";

    private readonly List<Object> _made = new List<Object>(); // of the page that is shown
    private OpenCollection _open;
    private IReadOnlyList<AssetRow> _rows = new AssetRow[0];

    /// <summary>The label that is chosen, or "" for all assets.</summary>
    public string Label { get; private set; } = "";

    /// <summary>From 0 on.</summary>
    public int Page { get; private set; }

    /// <summary>How many pages the chosen label has.</summary>
    public int Pages => 1 + (Chosen.Count - 1) / (Columns * Lines);

    private List<AssetRow> Chosen => _rows.Where(row => Label == "" || row.Labels.Contains(Label)).ToList();

    private async void Start()
    {
        try
        {
            await OpenAsync();
        }
        catch (CaptureFault fault)
        {
            Debug.LogError(fault.Message, this);
        }
    }

    /// <summary>Open the collection and show its first page. Throws CaptureFault.</summary>
    public async Task OpenAsync()
    {
        _open = await Catalogue.OpenAsync(baseUrl, collection, publicKey == "" ? new string[0] : new[] { publicKey });
        _rows = await _open.RowsAsync();
        await ShowAsync("", 0);
    }

    /// <summary>Show the assets with a label, or all for "".</summary>
    public async Task ShowAsync(string label, int page)
    {
        Clear();
        Label = label;
        Page = Mathf.Clamp(page, 0, Pages - 1);
        ShowLabels();
        if (Page > 0) Button("‹", -1, Lines, () => ShowAsync(Label, Page - 1));
        if (Page < Pages - 1) Button("›", Columns, Lines, () => ShowAsync(Label, Page + 1));
        var shown = Chosen.Skip(Page * Columns * Lines).Take(Columns * Lines).ToList();
        await Task.WhenAll(shown.Select((row, place) => ShowPicture(row, place % Columns, place / Columns)));
    }

    private void OnDestroy() => Clear();

    private void ShowLabels()
    {
        var labels = _rows.SelectMany(row => row.Labels).GroupBy(label => label).OrderByDescending(group => group.Count()).Select(group => group.Key);
        var column = 0;
        foreach (var label in new[] { "" }.Concat(labels.Take(MostLabels)))
        {
            Button(label == "" ? "All" : label, column++ - (MostLabels - Columns) / 2f - 0.5f, -0.7f, () => ShowAsync(label, 0));
        }
    }

    /// <summary>The front side of the picture of four; only the name where there is none, or where it cannot be had.</summary>
    private async Task ShowPicture(AssetRow row, int column, int line)
    {
        var card = Button(row.Label, column, line, () => Place(row.Key));
        byte[] png = null;
        try
        {
            png = await _open.PreviewAsync(row);
        }
        catch (CaptureFault fault)
        {
            Debug.LogError($"{row.Key}: {fault.Message}", this);
        }
        if (png == null || card == null) return; // the page has been turned meanwhile
        var texture = Made(new Texture2D(2, 2));
        texture.LoadImage(png, true);
        var material = Made(card.GetComponent<Renderer>().material);
        material.mainTexture = texture;
        material.mainTextureScale = new Vector2(0.5f, 0.5f);
        material.mainTextureOffset = new Vector2(0, 0.5f);
    }

    /// <summary>A square with text below it, to be pointed at.</summary>
    private GameObject Button(string text, float column, float line, System.Func<Task> onSelect)
    {
        var card = Made(GameObject.CreatePrimitive(PrimitiveType.Quad));
        card.name = text;
        card.transform.SetParent(transform, false);
        card.transform.localPosition = new Vector3((column - (Columns - 1) / 2f) * Step, (1 - line) * Step, 0);
        card.transform.localScale = Vector3.one * PictureSize;
        var name = new GameObject("name").AddComponent<TextMesh>();
        name.transform.SetParent(card.transform, false);
        name.transform.localPosition = new Vector3(0, -0.55f, 0);
        name.text = text;
        name.fontSize = 64;
        name.characterSize = LetterSize / PictureSize;
        name.anchor = TextAnchor.UpperCenter;
        // Last: the interactable looks for colliders when it begins.
        card.AddComponent<XRSimpleInteractable>().selectEntered.AddListener(_ => onSelect());
        return card;
    }

    private Task Place(string key)
    {
        var asset = new GameObject(key).AddComponent<CapturedAsset>();
        asset.Key = key;
        asset.Collection = _open;
        asset.Failed += fault => Debug.LogError($"{key}: {fault.Message}", this);
        return Task.CompletedTask;
    }

    private T Made<T>(T made) where T : Object
    {
        _made.Add(made);
        return made;
    }

    private void Clear()
    {
        foreach (var each in _made) Destroy(each);
        _made.Clear();
    }
}
