// The parts that call the engine use the scheduler, the storage and the meaning of faults, which no app needs.
[assembly: System.Runtime.CompilerServices.InternalsVisibleTo("Capture2vr")]
