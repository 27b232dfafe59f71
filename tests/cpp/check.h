// A test program in twenty lines: LAW("name") { CHECK(...); } blocks in main, `return toile_failures();` at the end.
#pragma once
#include <cstdio>

inline int& toile_failures() {
    static int count = 0;
    return count;
}

#define CHECK(condition)                                                        \
    do {                                                                        \
        if (!(condition)) {                                                     \
            std::printf("%s:%d: failed: %s\n", __FILE__, __LINE__, #condition); \
            ++toile_failures();                                                 \
        }                                                                       \
    } while (false)

#define CHECK_THROWS(Error, expression)                                                     \
    do {                                                                                    \
        bool thrown = false;                                                                \
        try {                                                                               \
            (void)(expression);                                                             \
        } catch (const Error&) {                                                            \
            thrown = true;                                                                  \
        }                                                                                   \
        if (!thrown) {                                                                      \
            std::printf("%s:%d: no %s from %s\n", __FILE__, __LINE__, #Error, #expression); \
            ++toile_failures();                                                             \
        }                                                                                   \
    } while (false)

#define LAW(name) std::printf("law: %s\n", name);
