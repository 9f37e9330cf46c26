/// @file mutant_switch.h -- what the sources that mutation.py switches are compiled with (C99 and C++17 by clang).
///
/// LPVGUARD_MUTANT in the environment is the number of the mutant that runs; without it every source does what it says. Each macro
/// below holds a site: n is the number of its first mutant, and lpvg_site(n) is k where mutant n + k runs. A site notes that it was
/// reached, and counts: a program that reaches many more than it should is in a loop that does not end.
#ifndef LPVGUARD_MUTANT_SWITCH_H
#define LPVGUARD_MUTANT_SWITCH_H

// Eigen checks its bounds, as the compiler does (mutation_run.py).
#undef EIGEN_NO_DEBUG

#define LPVG_SITES_MAX 262144

#ifdef __cplusplus
extern "C" {
#define LPVG_LET auto
#else
#define LPVG_LET __auto_type
#endif
extern int lpvg_mutant;                               // -1: none
extern unsigned char lpvg_reached[LPVG_SITES_MAX];    // by a site's number
extern unsigned long long lpvg_sites_left;            // that may still be reached
__attribute__((noreturn)) void lpvg_runs_on(void);    // ends the program

static inline __attribute__((unused)) int lpvg_site(int n) {
    lpvg_reached[n] = 1;
    if (--lpvg_sites_left == 0U) {
        lpvg_runs_on();
    }
    return lpvg_mutant - n;
}
#ifdef __cplusplus
}
#endif

#define LPVG_IS(n, k) (lpvg_site(n) == (k))

// Of two operands lpvg_a and lpvg_b: e0 as it stands, e1 ... the mutants.
#define LPVG_TWO(n, choice, l, r)        \
    __extension__({                      \
        LPVG_LET lpvg_a = l;             \
        LPVG_LET lpvg_b = r;             \
        const int lpvg_k = lpvg_site(n); \
        choice;                          \
    })
#define LPVG_TWO1(n, e0, e1, l, r) LPVG_TWO(n, lpvg_k == 0 ? (e1) : (e0), l, r)
#define LPVG_TWO2(n, e0, e1, e2, l, r) LPVG_TWO(n, lpvg_k == 0 ? (e1) : lpvg_k == 1 ? (e2) : (e0), l, r)
#define LPVG_TWO3(n, e0, e1, e2, e3, l, r) LPVG_TWO(n, lpvg_k == 0 ? (e1) : lpvg_k == 1 ? (e2) : lpvg_k == 2 ? (e3) : (e0), l, r)

// Of one operand lpvg_a.
#define LPVG_ONE(n, choice, x)           \
    __extension__({                      \
        LPVG_LET lpvg_a = x;             \
        const int lpvg_k = lpvg_site(n); \
        choice;                          \
    })
#define LPVG_ONE1(n, e0, e1, x) LPVG_ONE(n, lpvg_k == 0 ? (e1) : (e0), x)
#define LPVG_ONE2(n, e0, e1, e2, x) LPVG_ONE(n, lpvg_k == 0 ? (e1) : lpvg_k == 1 ? (e2) : (e0), x)
#define LPVG_ONE3(n, e0, e1, e2, e3, x) LPVG_ONE(n, lpvg_k == 0 ? (e1) : lpvg_k == 1 ? (e2) : lpvg_k == 2 ? (e3) : (e0), x)

// The same outside of functions.
#define LPVG_MADE(n, choice, x)          \
    [](auto lpvg_a) {                    \
        const int lpvg_k = lpvg_site(n); \
        return choice;                   \
    }(x)
#define LPVG_MADE1(n, e0, e1, x) LPVG_MADE(n, lpvg_k == 0 ? (e1) : (e0), x)
#define LPVG_MADE2(n, e0, e1, e2, x) LPVG_MADE(n, lpvg_k == 0 ? (e1) : lpvg_k == 1 ? (e2) : (e0), x)
#define LPVG_MADE3(n, e0, e1, e2, e3, x) LPVG_MADE(n, lpvg_k == 0 ? (e1) : lpvg_k == 1 ? (e2) : lpvg_k == 2 ? (e3) : (e0), x)

// The other one by De Morgan, so that neither side is evaluated where it was not; the left one alone; the right one alone.
#define LPVG_AND(n, l, r) (LPVG_IS(n, 0) != ((LPVG_IS(n, 0) != (LPVG_IS(n, 2) || l)) && (LPVG_IS(n, 0) != (LPVG_IS(n, 1) || r))))
#define LPVG_OR(n, l, r) (LPVG_IS(n, 0) != ((LPVG_IS(n, 0) != (!LPVG_IS(n, 2) && l)) || (LPVG_IS(n, 0) != (!LPVG_IS(n, 1) && r))))

// True; false.
#define LPVG_CONDITION(n, c) (LPVG_IS(n, 0) || (!LPVG_IS(n, 1) && c))
#define LPVG_WHILE(n, c) (!LPVG_IS(n, 0) && c)

#define LPVG_PREFIX(n, sign, other, x) (LPVG_IS(n, 0) ? other x : sign x)
#define LPVG_POSTFIX(n, sign, other, x) (LPVG_IS(n, 0) ? x other : x sign)
#define LPVG_EIGEN(n, sign, other, l, r) (LPVG_IS(n, 0) ? (l other r).eval() : (l sign r).eval())
#define LPVG_ASSIGN1(n, sign, other, l, r) (LPVG_IS(n, 0) ? (void)(l other r) : (void)(l sign r))
#define LPVG_ASSIGN2(n, sign, other, plain, l, r) (LPVG_IS(n, 0) ? (void)(l other r) : LPVG_IS(n, 1) ? (void)(l plain r) : (void)(l sign r))

#endif
