// Why an iterative kernel ended: one enumeration for all of them.
#pragma once
#include <array>
#include <string_view>

namespace toile {

enum class Stop {
    converged,       ///< what was sought is reached: steps below the tolerance, or no move that lowers the energy
    clear,           ///< untangle: nothing left inside, intersecting, or nearer than its margin
    max_iterations,  ///< the most iterations (steps, sweeps) that the options allow were made
    stalled,         ///< untangle: further steps left no less to do
    unmatched,       ///< skeleton: no part of the scan within reach; keypoints and priors alone gave the answer
    no_overlap,      ///< nricp: no part of the scan that may be a target lies near the template: no answer
};

/// In the order of Stop.
constexpr std::array<std::string_view, 6> stop_names{"converged", "clear",     "max_iterations",
                                                     "stalled",   "unmatched", "no_overlap"};

constexpr std::string_view name(Stop stop) { return stop_names[static_cast<std::size_t>(stop)]; }

}  // namespace toile
