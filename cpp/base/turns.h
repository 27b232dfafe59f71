// Calls of several threads on one object: who changes what it keeps waits for the others, or is refused.
#pragma once
#include <atomic>
#include <string>

#include "errors.h"
#include "parallel.h"

namespace toile {

/// Held by a call that changes what its object keeps; the next one waits. What a thread of the parent held when the process
/// was forked is half changed for ever: a call in the child is an InputError.
class Turn {
public:
    using Holder = std::atomic<int>;  ///< 0: no call; else 1 more than the forks that led to the holder's process

    Turn(Holder& holder, const char* kernel) : holder_(holder) {
        const int own = 1 + fork_count();
        for (int other = 0; !holder.compare_exchange_strong(other, own); other = 0) {
            if (other != own)
                throw InputError(
                    std::string(kernel) +
                    ": another thread was at work on this solver when the process was forked; make it anew");
            holder.wait(other);
        }
    }
    ~Turn() {
        holder_ = 0;
        holder_.notify_one();
    }
    Turn(const Turn&) = delete;
    Turn& operator=(const Turn&) = delete;

private:
    Holder& holder_;
};

/// For objects whose answers depend on which call came first: any number of calls read side by side or one writes, and a
/// call that would come between is an InputError.
class Calls {
public:
    class Reading {
    public:
        Reading(Calls& calls, const char* kernel) : count_(calls.count_) {
            for (int n = count_; n < 0 || !count_.compare_exchange_weak(n, n + 1);)
                if (n < 0) refuse(kernel);
        }
        ~Reading() { --count_; }
        Reading(const Reading&) = delete;
        Reading& operator=(const Reading&) = delete;

    private:
        std::atomic<int>& count_;
    };

    class Writing {
    public:
        Writing(Calls& calls, const char* kernel) : count_(calls.count_) {
            if (int none = 0; !count_.compare_exchange_strong(none, -1)) refuse(kernel);
        }
        ~Writing() { count_ = 0; }
        Writing(const Writing&) = delete;
        Writing& operator=(const Writing&) = delete;

    private:
        std::atomic<int>& count_;
    };

private:
    [[noreturn]] static void refuse(const char* kernel) {
        throw InputError(std::string(kernel) +
                         ": another thread is at work on this object, and what it keeps depends on who comes first; "
                         "make one for each thread");
    }

    std::atomic<int> count_{0};  ///< of the calls that read; -1: one that writes
};

}  // namespace toile
