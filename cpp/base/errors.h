// Errors of the core. Bad input is an InputError; a solve that fails on sound input is a SolveError.
#pragma once
#include <stdexcept>
#include <string>

namespace toile {

/// The caller's fault: the message names the kernel, the argument, what was expected and what came.
struct InputError : std::invalid_argument {
    using std::invalid_argument::invalid_argument;
};

/// The input was sound and the solve failed all the same.
struct SolveError : std::runtime_error {
    using std::runtime_error::runtime_error;
};

inline void require(bool condition, const std::string& message) {
    if (!condition) throw InputError(message);
}

}  // namespace toile
