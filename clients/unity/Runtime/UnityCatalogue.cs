using System;
using System.Collections.Generic;
using System.IO;
using System.Linq;
using System.Text;
using System.Threading.Tasks;
using UnityEngine;
using UnityEngine.AddressableAssets;
using UnityEngine.AddressableAssets.ResourceLocators;
using UnityEngine.ResourceManagement.AsyncOperations;
using UnityEngine.ResourceManagement.ResourceLocations;

namespace Capture2vr
{
    /// <summary>
    /// The catalogue of a collection that Addressables itself reads. There is one for collections of up to some thousand
    /// assets, and it may be half a minute behind the signed one.
    /// </summary>
    internal sealed class UnityCatalogue
    {
        private readonly string _folder;
        private readonly string _collection;
        private readonly string _withoutIt; // a file: the server had none when it was asked last
        private IResourceLocator _locator;
        private IResourceLocator _before; // of the last update: who has one of its locations may still load it
        private string _hash;

        /// <param name="notes">a folder of this device for what to know at the next start</param>
        public UnityCatalogue(string baseUrl, string collection, string notes)
        {
            _folder = $"{baseUrl}/collections/{collection}/unity";
            _collection = collection;
            _withoutIt = Path.Combine(notes, "no-unity-catalogue");
        }

        /// <summary>Whether it is there and kept up to date. One that the server has no more is still read by Addressables.</summary>
        public bool IsInUse { get; private set; }

        public IEnumerable<string> Keys => IsInUse ? _locator.Keys.OfType<string>() : Enumerable.Empty<string>();

        /// <summary>The asset of a key, or those of a label.</summary>
        public IEnumerable<IResourceLocation> AssetsAt(string key)
        {
            return IsInUse && _locator.Locate(key, typeof(GameObject), out var found) ? found : Enumerable.Empty<IResourceLocation>();
        }

        public bool Has(IResourceLocation location)
        {
            return new[] { _locator, _before }.Any(locator => locator != null
                && locator.Locate(location.PrimaryKey, null, out var found) && found.Any(each => AssetLocation.IsSame(each, location)));
        }

        /// <summary>
        /// Take the newest, or without a network what the device has. Throws CaptureFault FILE_MISSING where the server has none,
        /// UNREACHABLE, ACCESS_REFUSED, CATALOGUE_UNREADABLE.
        /// </summary>
        public Task TakeAsync() => _locator == null ? Load() : Update();

        /// <summary>Do without it, as the server does.</summary>
        public void Abandon()
        {
            IsInUse = false;
            Note();
        }

        private async Task Load()
        {
            string hash = null;
            CaptureFault unreachable = null;
            try
            {
                hash = await Hash();
            }
            catch (CaptureFault fault) when (fault.Code == CaptureFault.Unreachable && !File.Exists(_withoutIt))
            {
                unreachable = fault; // the device may have the catalogue
            }
            var loading = Addressables.LoadContentCatalogAsync(Address(Catalogue.FileName), false);
            await Completion.Of(loading);
            var cause = loading.OperationException;
            if (loading.Status == AsyncOperationStatus.Succeeded) _locator = loading.Result;
            Addressables.Release(loading);
            if (_locator == null) throw unreachable ?? Unreadable(cause);
            _hash = hash;
            IsInUse = true;
            Storage.Flush(); // Addressables keeps catalogues, too
        }

        /// <summary>Only this collection: the app's own catalogues are its own affair.</summary>
        private async Task Update()
        {
            var hash = await Hash();
            IsInUse = true;
            if (hash == _hash) return;
            var updating = Addressables.UpdateCatalogs(new[] { _locator.LocatorId }, false);
            await Completion.Of(updating);
            var found = updating.Status == AsyncOperationStatus.Succeeded
                ? updating.Result.FirstOrDefault(each => each.LocatorId == _locator.LocatorId) : null;
            Addressables.Release(updating);
            if (found == null) return;
            _before = _locator;
            _locator = found;
            _hash = hash;
            Storage.Flush();
        }

        /// <summary>
        /// What changes with the catalogue. Asked for here, because Addressables tells a refusal from a lost connection as
        /// little as a missing collection from a damaged one.
        /// </summary>
        private async Task<string> Hash()
        {
            using (var memory = new MemoryStream())
            {
                await Catalogue.FetchAsync(Address(Path.ChangeExtension(Catalogue.FileName, ".hash")), memory);
                File.Delete(_withoutIt);
                return Encoding.UTF8.GetString(memory.ToArray());
            }
        }

        /// <summary>Without a network Addressables would give the last one that it has, however old.</summary>
        private void Note()
        {
            try
            {
                File.WriteAllText(_withoutIt, "");
            }
            catch (Exception fault) when (fault is IOException || fault is UnauthorizedAccessException)
            {
                // A full disk: the next start without a network may show an older version.
            }
        }

        private string Address(string file) => $"{_folder}/{file}";

        private CaptureFault Unreadable(Exception cause)
        {
            return new CaptureFault(CaptureFault.CatalogueUnreadable,
                $"the catalogue of collection {_collection} is there, and Addressables cannot read it: {cause?.Message}",
                $"Is {Catalogue.FileName} the form that the installed Addressables reads?", cause);
        }
    }
}
