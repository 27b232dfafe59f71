// What nricp refuses.
#pragma once
#include "kernels/nricp.h"

namespace toile {

constexpr double largest_length = 1e30;  ///< powers of lengths must stay within the range of doubles

void check_size(const char* name, const Vertices& V);
void check_options(const NricpOptions& options);

/// One frame for a template of n vertices; landmarks, loops and labels may be missing.
void check_frame(const NricpFrame& frame, Eigen::Index n, const NricpOptions& options);

}  // namespace toile
