#include "base/parallel.h"

#include <omp.h>
#include <pthread.h>

namespace toile {

namespace {

bool forked = false;
[[maybe_unused]] const int handler = pthread_atfork(nullptr, nullptr, [] { forked = true; });

}  // namespace

int thread_count() { return forked ? 1 : omp_get_max_threads(); }

}  // namespace toile
