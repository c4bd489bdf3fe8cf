/* System calls on paths below one folder, the n-th of which fails; loaded with LD_PRELOAD.
 *
 * Calls of the C library's streams count as the system calls that they make sooner or later. A
 * write that fails for want of space writes the first half before, as a disk that fills up does.
 */
#define _GNU_SOURCE
#include <dirent.h>
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdio_ext.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/sendfile.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>

enum { OPEN, WRITE, FSYNC, RENAME, MKDIR, READ, CALLS };

struct shared {
    long count[CALLS];  /* calls so far */
    char where[256];    /* what failed first, and on which path */
};

static struct shared *shared;
static char root[PATH_MAX];
static size_t root_length;
static int failing = -1, error_number, goes_on;
static long failing_at;
static void (*listener)(int call, const char *path);

/* Memory that a process shares with those that it forks. */
struct shared *faults_shared(void) {
    if (!shared) {
        shared = mmap(NULL, sizeof *shared, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    }
    return shared;
}

/* From now on count, and fail the call `at` of a kind; with `onwards`, all after it, too. */
void faults_arm(const char *folder, int call, long at, int number, int onwards) {
    memset(faults_shared(), 0, sizeof *shared);
    failing = call, failing_at = at, error_number = number, goes_on = onwards;
    snprintf(root, sizeof root, "%s/", folder);
    root_length = strlen(root);
}

/* Whom to tell of each call that is counted, before it is made. */
void faults_tell(void (*to)(int call, const char *path)) { listener = to; }

static int below(const char *path) { return strncmp(path, root, root_length) == 0; }

static int fails(int call, const char *path) {
    if (listener) listener(call, path);
    long number = __atomic_add_fetch(&shared->count[call], 1, __ATOMIC_SEQ_CST);
    if (call != failing || number < failing_at || (number > failing_at && !goes_on)) return 0;
    if (number == failing_at) snprintf(shared->where, sizeof shared->where, "%s", path);
    errno = error_number;
    return 1;
}

/* A path without links followed; those of a folder are taken from where it was opened. */
static int path_fails(int call, int folder, const char *path) {
    if (!root_length) return 0;
    char whole[2 * PATH_MAX], link[64], start[PATH_MAX];
    if (path[0] == '/') {
        snprintf(whole, sizeof whole, "%s", path);
    } else {
        ssize_t length = 0;
        if (folder == AT_FDCWD) {
            if (!getcwd(start, sizeof start)) return 0;
        } else {
            snprintf(link, sizeof link, "/proc/self/fd/%d", folder);
            if ((length = readlink(link, start, sizeof start - 1)) < 0) return 0;
            start[length] = 0;
        }
        snprintf(whole, sizeof whole, "%s/%s", start, path);
    }
    return below(whole) && fails(call, whole);
}

static int handle_fails(int call, int handle) {
    if (!root_length) return 0;
    char link[64], path[PATH_MAX];
    snprintf(link, sizeof link, "/proc/self/fd/%d", handle);
    ssize_t length = readlink(link, path, sizeof path - 1);
    if (length < 0) return 0;
    path[length] = 0;
    return below(path) && fails(call, path);
}

#define REAL(name) \
    static __typeof__(name) *real; \
    if (!real) real = (__typeof__(name) *)dlsym(RTLD_NEXT, #name)
#define MODE(flags) \
    mode_t mode = 0; \
    if ((flags) & (O_CREAT | __O_TMPFILE)) { \
        va_list rest; \
        va_start(rest, flags); \
        mode = va_arg(rest, mode_t); \
        va_end(rest); \
    }

#define OPENS(name) \
    int name(const char *path, int flags, ...) { \
        REAL(name); \
        MODE(flags) \
        return path_fails(OPEN, AT_FDCWD, path) ? -1 : real(path, flags, mode); \
    }
OPENS(open)
OPENS(open64)

#define OPENS_AT(name) \
    int name(int folder, const char *path, int flags, ...) { \
        REAL(name); \
        MODE(flags) \
        return path_fails(OPEN, folder, path) ? -1 : real(folder, path, flags, mode); \
    }
OPENS_AT(openat)
OPENS_AT(openat64)

#define OPENS_CHECKED(name) \
    int name(const char *path, int flags); \
    int name(const char *path, int flags) { \
        REAL(name); \
        return path_fails(OPEN, AT_FDCWD, path) ? -1 : real(path, flags); \
    }
OPENS_CHECKED(__open_2)
OPENS_CHECKED(__open64_2)

#define OPENS_STREAM(name) \
    FILE *name(const char *path, const char *mode) { \
        REAL(name); \
        return path_fails(OPEN, AT_FDCWD, path) ? NULL : real(path, mode); \
    }
OPENS_STREAM(fopen)
OPENS_STREAM(fopen64)

DIR *opendir(const char *path) {
    REAL(opendir);
    return path_fails(OPEN, AT_FDCWD, path) ? NULL : real(path);
}

#define WRITES_NONE(length) (error_number != ENOSPC || (length) < 2)

ssize_t write(int handle, const void *data, size_t length) {
    REAL(write);
    if (!handle_fails(WRITE, handle)) return real(handle, data, length);
    if (!WRITES_NONE(length)) (void)!real(handle, data, length / 2);
    errno = error_number;
    return -1;
}

#define WRITES_AT(name, offset_type) \
    ssize_t name(int handle, const void *data, size_t length, offset_type offset) { \
        REAL(name); \
        if (!handle_fails(WRITE, handle)) return real(handle, data, length, offset); \
        if (!WRITES_NONE(length)) (void)!real(handle, data, length / 2, offset); \
        errno = error_number; \
        return -1; \
    }
WRITES_AT(pwrite, off_t)
WRITES_AT(pwrite64, off64_t)

ssize_t writev(int handle, const struct iovec *parts, int count) {
    REAL(writev);
    return handle_fails(WRITE, handle) ? -1 : real(handle, parts, count);
}

ssize_t sendfile(int to, int from, off_t *offset, size_t length) {
    REAL(sendfile);
    return handle_fails(WRITE, to) ? -1 : real(to, from, offset, length);
}

ssize_t sendfile64(int to, int from, off64_t *offset, size_t length) {
    REAL(sendfile64);
    return handle_fails(WRITE, to) ? -1 : real(to, from, offset, length);
}

ssize_t copy_file_range(int from, off64_t *start, int to, off64_t *end, size_t length, unsigned flags) {
    REAL(copy_file_range);
    return handle_fails(WRITE, to) ? -1 : real(from, start, to, end, length, flags);
}

size_t fwrite(const void *data, size_t size, size_t count, FILE *file) {
    REAL(fwrite);
    if (!handle_fails(WRITE, fileno(file))) return real(data, size, count, file);
    size_t half = WRITES_NONE(count) ? 0 : real(data, size, count / 2, file);
    errno = error_number;
    return half;
}

int fflush(FILE *file) {
    REAL(fflush);
    return file && __fpending(file) && handle_fails(WRITE, fileno(file)) ? EOF : real(file);
}

int fclose(FILE *file) {
    REAL(fclose);
    if (!__fpending(file) || !handle_fails(WRITE, fileno(file))) return real(file);
    __fpurge(file);
    real(file);
    errno = error_number;
    return EOF;
}

int fsync(int handle) {
    REAL(fsync);
    return handle_fails(FSYNC, handle) ? -1 : real(handle);
}

int fdatasync(int handle) {
    REAL(fdatasync);
    return handle_fails(FSYNC, handle) ? -1 : real(handle);
}

int rename(const char *from, const char *to) {
    REAL(rename);
    return path_fails(RENAME, AT_FDCWD, to) ? -1 : real(from, to);
}

int renameat(int from_folder, const char *from, int to_folder, const char *to) {
    REAL(renameat);
    return path_fails(RENAME, to_folder, to) ? -1 : real(from_folder, from, to_folder, to);
}

int renameat2(int from_folder, const char *from, int to_folder, const char *to, unsigned flags) {
    REAL(renameat2);
    return path_fails(RENAME, to_folder, to) ? -1 : real(from_folder, from, to_folder, to, flags);
}

int mkdir(const char *path, mode_t mode) {
    REAL(mkdir);
    return path_fails(MKDIR, AT_FDCWD, path) ? -1 : real(path, mode);
}

int mkdirat(int folder, const char *path, mode_t mode) {
    REAL(mkdirat);
    return path_fails(MKDIR, folder, path) ? -1 : real(folder, path, mode);
}

ssize_t read(int handle, void *data, size_t length) {
    REAL(read);
    return handle_fails(READ, handle) ? -1 : real(handle, data, length);
}

#define READS_AT(name, offset_type) \
    ssize_t name(int handle, void *data, size_t length, offset_type offset) { \
        REAL(name); \
        return handle_fails(READ, handle) ? -1 : real(handle, data, length, offset); \
    }
READS_AT(pread, off_t)
READS_AT(pread64, off64_t)

ssize_t readv(int handle, const struct iovec *parts, int count) {
    REAL(readv);
    return handle_fails(READ, handle) ? -1 : real(handle, parts, count);
}

size_t fread(void *data, size_t size, size_t count, FILE *file) {
    REAL(fread);
    return handle_fails(READ, fileno(file)) ? 0 : real(data, size, count, file);
}
