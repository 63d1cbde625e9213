/* Preloaded into a process: its n-th operation on a file fails, or the process is killed there (tests/machine/test_crash.py). */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdarg.h>
#include <sys/sendfile.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <unistd.h>

enum { ONCE, FROM_THERE_ON, KILL };

static long at = -1, count = 0;
static int mode = ONCE, armed = 0;

void fault_arm(long n, int how) { at = n; mode = how; count = 0; armed = 1; }
long fault_count(void) { armed = 0; return count; }

static int failing(void) {
    if (!armed) return 0;
    long n = count++;
    if (mode == ONCE && n == at) return EIO;
    return mode == FROM_THERE_ON && n >= at ? ENOSPC : 0;
}
static int killing(void) { return armed && mode == KILL && count - 1 == at; }

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))
/* an operation that is done or not; one on data is half done when the process is killed */
#define WRAP(type, name, parameters, arguments, half) \
    type name parameters { \
        if ((errno = failing()) != 0) return -1; \
        if (killing()) { half; kill(getpid(), SIGKILL); } \
        return REAL(name) arguments; \
    }
WRAP(ssize_t, write, (int f, const void *b, size_t n), (f, b, n), REAL(write)(f, b, n / 2))
WRAP(ssize_t, sendfile, (int o, int i, off_t *p, size_t n), (o, i, p, n), )
WRAP(ssize_t, sendfile64, (int o, int i, off64_t *p, size_t n), (o, i, p, n), )
WRAP(ssize_t, copy_file_range, (int i, off64_t *p, int o, off64_t *q, size_t n, unsigned g), (i, p, o, q, n, g), )
WRAP(int, ftruncate, (int f, off_t n), (f, n), )
WRAP(int, ftruncate64, (int f, off64_t n), (f, n), )
WRAP(int, fsync, (int f), (f), )
WRAP(int, rename, (const char *a, const char *b), (a, b), )
WRAP(int, link, (const char *a, const char *b), (a, b), )
WRAP(int, unlink, (const char *a), (a), )
WRAP(int, unlinkat, (int d, const char *a, int g), (d, a, g), )
WRAP(int, rmdir, (const char *a), (a), )
WRAP(int, mkdir, (const char *a, mode_t m), (a, m), )
WRAP(int, chmod, (const char *a, mode_t m), (a, m), )

#define OPEN(name) \
    int name(const char *path, int flags, ...) { \
        va_list rest; \
        va_start(rest, flags); \
        mode_t m = va_arg(rest, mode_t); \
        va_end(rest); \
        if (flags & O_CREAT) { \
            if ((errno = failing()) != 0) return -1; \
            if (killing()) kill(getpid(), SIGKILL); \
        } \
        return REAL(name)(path, flags, m); \
    }
OPEN(open)
OPEN(open64)
