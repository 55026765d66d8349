using System.IO;
using UnityEditor.Build;
using UnityEditor.Build.Reporting;
using UnityEditor.UnityLinker;

namespace Capture2vr.Editor
{
    /// <summary>Hands the package's link.xml to the linker, which looks for such files in Assets only.</summary>
    internal sealed class LinkXml : IUnityLinkerProcessor
    {
        private const string InPackage = "Packages/com.capture2vr.client/Runtime/link.xml";

        public int callbackOrder => 0;

        public string GenerateAdditionalLinkXmlFile(BuildReport report, UnityLinkerBuildPipelineData data)
        {
            return Path.GetFullPath(InPackage);
        }
    }
}
