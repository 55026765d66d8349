using System.Threading.Tasks;
using UnityEngine.ResourceManagement.AsyncOperations;

namespace Capture2vr
{
    /// <summary>Awaits operations of Addressables by their event: their Task is not there in a browser, as its manual says.</summary>
    internal static class Completion
    {
        /// <summary>Ends when the operation has, well or not. The handle stays due to be released.</summary>
        public static Task Of<T>(AsyncOperationHandle<T> handle)
        {
            // Posted to the main thread instead of run inside the event, where nobody should release what has just ended.
            var done = new TaskCompletionSource<bool>(TaskCreationOptions.RunContinuationsAsynchronously);
            handle.Completed += _ => done.SetResult(true);
            return done.Task;
        }
    }
}
