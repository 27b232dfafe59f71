#include "base/parallel.h"

#include <omp.h>
#include <pthread.h>

namespace toile {

namespace {

int forks = 0;
[[maybe_unused]] const int handler = pthread_atfork(nullptr, nullptr, [] { ++forks; });

}  // namespace

int thread_count() { return forks > 0 ? 1 : omp_get_max_threads(); }

int fork_count() { return forks; }

}  // namespace toile
