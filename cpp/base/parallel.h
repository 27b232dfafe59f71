// Parallel loops whose results do not depend on the number of threads: independent items write to their own
// places, and sums run over fixed blocks that are added in order.
#pragma once
#include <algorithm>
#include <cstdint>
#include <exception>
#include <vector>

namespace toile {

/// How many threads a loop may use: OpenMP's number for this thread, but 1 in a forked child. Only the thread that calls
/// fork goes on in the child; a loop there would wait for ever for the others of its team.
int thread_count();

/// How many forks led to this process since the core was loaded.
int fork_count();

/// Calls f(i) for i in [0, n), in any order; f must write only to places of its own item.
template <class Function>
void parallel_for(std::int64_t n, Function&& f, std::int64_t grain = 256) {
    std::exception_ptr error;
    const std::int64_t blocks = (n + grain - 1) / grain;
#pragma omp parallel for schedule(dynamic, 1) if (blocks > 1 && thread_count() > 1)
    for (std::int64_t b = 0; b < blocks; ++b) {
        try {
            for (std::int64_t i = b * grain, end = std::min(n, i + grain); i < end; ++i) f(i);
        } catch (...) {
#pragma omp critical(toile_parallel_error)
            if (!error) error = std::current_exception();
        }
    }
    if (error) std::rethrow_exception(error);
}

/// Sum over fixed blocks: f(partial, i) adds item i to its block's partial sum; partials are added in block order,
/// so the rounding is the same for every number of threads. `zero` is the empty sum; Sum needs operator+=.
template <class Sum, class Function>
Sum parallel_sum(std::int64_t n, const Sum& zero, Function&& f, std::int64_t block = 1024) {
    const std::int64_t blocks = (n + block - 1) / block;
    std::vector<Sum> partial(static_cast<std::size_t>(blocks), zero);
    parallel_for(blocks, [&](std::int64_t b) {
        for (std::int64_t i = b * block, end = std::min(n, i + block); i < end; ++i) f(partial[b], i);
    }, 1);
    Sum total = zero;
    for (const Sum& p : partial) total += p;
    return total;
}

}  // namespace toile
