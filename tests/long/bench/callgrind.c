/* What callgrind counts in a process: nothing before ``begin``, then all but what is between ``out`` and ``in``. */
#include <valgrind/callgrind.h>

void begin(void)
{
    CALLGRIND_START_INSTRUMENTATION;
    CALLGRIND_ZERO_STATS;
}

void toggle(void)
{
    CALLGRIND_TOGGLE_COLLECT;
}

void end(void)
{
    CALLGRIND_DUMP_STATS;
}
