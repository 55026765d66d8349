using System;
using System.Collections.Generic;
using System.Linq;
using System.Threading;
using System.Threading.Tasks;

namespace Capture2vr
{
    /// <summary>Does the same for many items, a few of them at a time: one after the other a network's delays would add up.</summary>
    internal static class Several
    {
        private const int AtOnce = 8;

        /// <summary>The results in the order of the items. Throws the first fault, after which no further item is begun.</summary>
        public static async Task<IReadOnlyList<TResult>> Of<T, TResult>(IReadOnlyList<T> items, Func<T, Task<TResult>> work)
        {
            var results = new TResult[items.Count];
            var begun = 0;
            Func<Task> worker = async () =>
            {
                for (int place; (place = Interlocked.Increment(ref begun) - 1) < items.Count;)
                {
                    try
                    {
                        results[place] = await work(items[place]).ConfigureAwait(Background.ComesBack);
                    }
                    catch
                    {
                        Interlocked.Exchange(ref begun, items.Count);
                        throw;
                    }
                    await Background.Pause().ConfigureAwait(Background.ComesBack);
                }
            };
            await Task.WhenAll(Enumerable.Range(0, Math.Min(AtOnce, items.Count)).Select(_ => worker())).ConfigureAwait(Background.ComesBack);
            return results;
        }
    }
}
