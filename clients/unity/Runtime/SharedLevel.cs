using System;
using System.Collections.Generic;
using System.IO;
using System.Linq;
using System.Threading.Tasks;
using GLTFast;
using GLTFast.Logging;
using UnityEngine;

namespace Capture2vr
{
    /// <summary>
    /// A level of detail that has been decoded: glTFast's import, which owns the meshes, materials and textures that all
    /// copies in the scene share. It lives as long as somebody uses it, and its file stays on the device as long.
    /// </summary>
    internal sealed class SharedLevel
    {
        private const int Anisotropy = 4; // a floor or a sleeve seen along its surface; more costs bandwidth on a headset

        private static readonly Dictionary<string, SharedLevel> Shared = new Dictionary<string, SharedLevel>();

        private readonly GlbFile _file;
        private readonly Task<GltfImport> _import;
        private int _users;

        private SharedLevel(GlbFile file)
        {
            _file = file;
            _import = Decode(file);
        }

        /// <summary>The level of a file, decoded once for all who take it. Each Take is due a Release, whatever comes of it.</summary>
        public static SharedLevel Take(GlbFile file)
        {
            if (!Shared.TryGetValue(file.Sha256, out var level)) level = Shared[file.Sha256] = new SharedLevel(file);
            level._users++;
            return level;
        }

        /// <summary>Put a copy below an object. Throws CaptureFault where the file cannot be had or no mesh be made of it.</summary>
        public async Task InstantiateAsync(Transform parent)
        {
            var import = await _import;
            if (!await import.InstantiateMainSceneAsync(parent)) throw Invalid(_file, "its scene cannot be made");
        }

        public void Release()
        {
            if (--_users > 0) return;
            // Who takes it from now on decodes anew: this one may have failed.
            if (Shared.TryGetValue(_file.Sha256, out var level) && level == this) Shared.Remove(_file.Sha256);
            Free();
        }

        private async void Free()
        {
            try
            {
                (await _import).Dispose();
            }
            catch (Exception)
            {
                return; // nothing came of it, and whoever asked was told
            }
            Catalogue.Cache.Release(_file.Sha256);
        }

        internal static void Forget() => Shared.Clear();

        /// <summary>The file is read on another thread where there is one; glTFast spreads its work over frames.</summary>
        private static async Task<GltfImport> Decode(GlbFile file)
        {
            var path = await Catalogue.Cache.Load(file.Url, file.Sha256, file.Size).Task;
            var log = new CollectingLogger();
            var import = new GltfImport(null, null, null, log);
            try
            {
                var data = await Background.Run(() => Task.FromResult(File.ReadAllBytes(path)));
                // Mips: without them the textures of distant assets glitter.
                var settings = new ImportSettings { GenerateMipMaps = true, AnisotropicFilterLevel = Anisotropy };
                if (await import.Load(data, null, settings)) return import;
                throw Invalid(file, Said(log));
            }
            catch
            {
                import.Dispose();
                Catalogue.Cache.Release(file.Sha256);
                throw;
            }
        }

        private static string Said(CollectingLogger log)
        {
            return log.Count == 0 ? "glTFast says nothing" : string.Join("; ", log.Items.Select(each => each.ToString()));
        }

        private static CaptureFault Invalid(GlbFile file, string reason)
        {
            return new CaptureFault(CaptureFault.MeshInvalid, $"{file.Url}: no mesh can be made of it: {reason}",
                "If it names EXT_meshopt_compression or KHR_texture_basisu, add com.unity.meshopt.decompress or com.unity.cloud.ktx");
        }
    }
}
