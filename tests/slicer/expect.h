/* Checks that do not stop the test when they fail. The program's exit status tells whether all of them passed. */
#ifndef TROCAR_TESTS_SLICER_EXPECT_H
#define TROCAR_TESTS_SLICER_EXPECT_H

#include <chrono>
#include <cmath>
#include <cstdio>
#include <thread>

inline int failures = 0;

#define EXPECT(condition, ...)                                          \
    do {                                                                \
        if (!(condition)) {                                             \
            failures++;                                                 \
            std::fprintf(stderr, "%s:%d: %s:", __FILE__, __LINE__, #condition); \
            std::fprintf(stderr, " " __VA_ARGS__);                       \
            std::fputc('\n', stderr);                                   \
        }                                                               \
    } while (0)

inline double seconds() { return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(); }
inline double epoch_seconds() { return std::chrono::duration<double>(std::chrono::system_clock::now().time_since_epoch()).count(); }
inline void wait(double s) { std::this_thread::sleep_for(std::chrono::duration<double>(s)); }

/* Waits until the condition holds. Returns false after `patience` s. */
template <typename Condition> bool soon(Condition holds, double patience = 10) {
    for (double end = seconds() + patience; seconds() < end; wait(0.01))
        if (holds()) return true;
    return holds();
}

#endif
