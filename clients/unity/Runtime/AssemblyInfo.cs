// Only catalogues name the providers, as text; without this the linker would leave the whole assembly out of a player.
[assembly: UnityEngine.Scripting.AlwaysLinkAssembly]
