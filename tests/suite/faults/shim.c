/* Intercepts system calls that change files below a folder: counts them, fails or kills at one of them, and records
   changes and synchronisations.

   FAULT_UNDER  the folder
   FAULT_AT     number of the call, from 1; 0 for none
   FAULT        enospc, eio or kill
   FAULT_TRACE  file for the record; its last line has the number of calls */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

#define MAX_FDS 4096
static char *path_of[MAX_FDS];
static long calls;
static int trace = -1;
static pthread_mutex_t mutex = PTHREAD_MUTEX_INITIALIZER;

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

static int under(const char *path) {
    const char *folder = getenv("FAULT_UNDER");
    return folder && path && strncmp(path, folder, strlen(folder)) == 0;
}

static void put(const void *bytes, size_t count) {
    static ssize_t (*real)(int, const void *, size_t);
    if (!real) real = REAL(write);
    if (trace >= 0 && real(trace, bytes, count) < 0) abort();
}

/* Writes a line of the trace. */
static void say(const char *format, ...) {
    if (trace < 0) return;
    char line[8192];
    va_list arguments;
    va_start(arguments, format);
    int count = vsnprintf(line, sizeof line, format, arguments);
    va_end(arguments);
    put(line, (size_t)count);
}

/* Counts a call. Returns -1 if it must fail. The caller holds the mutex. */
static int counted(void) {
    const char *path = getenv("FAULT_TRACE");
    if (trace < 0 && path) trace = REAL(open)(path, O_CREAT | O_WRONLY | O_APPEND, 0644);
    calls++;
    const char *at = getenv("FAULT_AT"), *fault = getenv("FAULT");
    if (!at || atol(at) != calls || !fault) return 0;
    if (strcmp(fault, "kill") == 0) {
        kill(getpid(), SIGKILL);
        pause();
    }
    errno = strcmp(fault, "eio") == 0 ? EIO : ENOSPC;
    return -1;
}

static int opened(int (*real)(const char *, int, ...), const char *path, int flags, mode_t mode) {
    int changes = (flags & O_CREAT) || (flags & O_TRUNC);
    if (!under(path)) return real(path, flags, mode);
    pthread_mutex_lock(&mutex);
    int fd = changes && counted() ? -1 : real(path, flags, mode);
    if (fd >= 0 && fd < MAX_FDS) {
        free(path_of[fd]);
        path_of[fd] = strdup(path);
        if (changes) say("open %d %d %s\n", fd, !!(flags & O_TRUNC), path);
        else say("reopen %d %s\n", fd, path);
    }
    pthread_mutex_unlock(&mutex);
    return fd;
}

#define OPEN(name)                                                                                                     \
    int name(const char *path, int flags, ...) {                                                                       \
        va_list arguments;                                                                                             \
        va_start(arguments, flags);                                                                                    \
        mode_t mode = (flags & (O_CREAT | O_TMPFILE)) ? va_arg(arguments, mode_t) : 0;                                 \
        va_end(arguments);                                                                                             \
        return opened(REAL(name), path, flags, mode);                                                                  \
    }
OPEN(open)
OPEN(open64)

int close(int fd) {
    pthread_mutex_lock(&mutex);
    if (fd >= 0 && fd < MAX_FDS && path_of[fd]) {
        free(path_of[fd]);
        path_of[fd] = NULL;
        say("close %d\n", fd);
    }
    pthread_mutex_unlock(&mutex);
    return REAL(close)(fd);
}

static int known(int fd) { return fd >= 0 && fd < MAX_FDS && path_of[fd]; }

ssize_t write(int fd, const void *bytes, size_t count) {
    if (!known(fd)) return REAL(write)(fd, bytes, count);
    pthread_mutex_lock(&mutex);
    ssize_t done = counted() ? -1 : REAL(write)(fd, bytes, count);
    if (done > 0) {
        say("write %d %ld %ld\n", fd, (long)(lseek(fd, 0, SEEK_CUR) - done), (long)done);
        put(bytes, (size_t)done);
        say("\n");
    }
    pthread_mutex_unlock(&mutex);
    return done;
}

#define SYNC(name)                                                                                                     \
    int name(int fd) {                                                                                                 \
        if (!known(fd)) return REAL(name)(fd);                                                                         \
        pthread_mutex_lock(&mutex);                                                                                    \
        int done = counted() ? -1 : REAL(name)(fd);                                                                    \
        if (done == 0) say("sync %d\n", fd);                                                                           \
        pthread_mutex_unlock(&mutex);                                                                                  \
        return done;                                                                                                   \
    }
SYNC(fsync)
SYNC(fdatasync)

#define CUT(name, type)                                                                                                \
    int name(int fd, type length) {                                                                                    \
        if (!known(fd)) return REAL(name)(fd, length);                                                                 \
        pthread_mutex_lock(&mutex);                                                                                    \
        int done = counted() ? -1 : REAL(name)(fd, length);                                                            \
        if (done == 0) say("cut %d %ld\n", fd, (long)length);                                                          \
        pthread_mutex_unlock(&mutex);                                                                                  \
        return done;                                                                                                   \
    }
CUT(ftruncate, off_t)
CUT(ftruncate64, off64_t)

#define NAMES(name, word)                                                                                              \
    int name(const char *from, const char *to) {                                                                       \
        if (!under(to)) return REAL(name)(from, to);                                                                   \
        pthread_mutex_lock(&mutex);                                                                                    \
        int done = counted() ? -1 : REAL(name)(from, to);                                                              \
        if (done == 0) say(word " %s\t%s\n", from, to);                                                                \
        pthread_mutex_unlock(&mutex);                                                                                  \
        return done;                                                                                                   \
    }
NAMES(rename, "rename")
NAMES(link, "link")

int linkat(int old, const char *from, int new, const char *to, int flags) {
    if (!under(to)) return REAL(linkat)(old, from, new, to, flags);
    pthread_mutex_lock(&mutex);
    int done = counted() ? -1 : REAL(linkat)(old, from, new, to, flags);
    if (done == 0) say("link %s\t%s\n", from, to);
    pthread_mutex_unlock(&mutex);
    return done;
}

#define GONE(name)                                                                                                     \
    int name(const char *path) {                                                                                       \
        if (!under(path)) return REAL(name)(path);                                                                     \
        pthread_mutex_lock(&mutex);                                                                                    \
        int done = counted() ? -1 : REAL(name)(path);                                                                  \
        if (done == 0) say("remove %s\n", path);                                                                       \
        pthread_mutex_unlock(&mutex);                                                                                  \
        return done;                                                                                                   \
    }
GONE(unlink)
GONE(rmdir)

int mkdir(const char *path, mode_t mode) {
    if (!under(path)) return REAL(mkdir)(path, mode);
    pthread_mutex_lock(&mutex);
    int done = counted() ? -1 : REAL(mkdir)(path, mode);
    if (done == 0) say("folder %s\n", path);
    pthread_mutex_unlock(&mutex);
    return done;
}

__attribute__((destructor)) static void ended(void) { say("calls %ld\n", calls); }
