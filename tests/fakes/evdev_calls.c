/* The calls of a process to a fake event device (wheel.c), in place of the kernel's: for LD_PRELOAD.
 *
 *     MANYHANDS_FAKE_EVDEV=/path/of/the/socket LD_PRELOAD=.../evdev_calls.so manyhands ...
 *
 * The path of the socket is that of the device. Its descriptor is the connected socket itself, so closing it, and the
 * death of its process, reach the fake as they reach a kernel. All other descriptors and paths go to the C library.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include "evdev_rpc.h"

#define MOST_FDS 4096
static char ours[MOST_FDS];

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

static int is_ours(int fd) { return fd >= 0 && fd < MOST_FDS && ours[fd]; }

static long ask(int fd, rpc_request *asked, rpc_reply *reply) {
    ssize_t n;
    if (send(fd, asked, RPC_ASKED + asked->size, MSG_NOSIGNAL) < 0) return errno = ENODEV, -1;
    do n = recv(fd, reply, sizeof *reply, 0);
    while (n < 0 && errno == EINTR);
    if (n < RPC_ANSWERED) return errno = ENODEV, -1; /* the fake has ended */
    if (reply->result < 0) return errno = (int)-reply->result, -1;
    return (long)reply->result;
}

static int opened(const char *path) {
    struct sockaddr_un at = {.sun_family = AF_UNIX};
    rpc_request asked = {.op = RPC_OPEN};
    rpc_reply reply;
    strncpy(at.sun_path, path, sizeof at.sun_path - 1);
    const int fd = socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0);
    if (fd < 0) return -1;
    if (fd >= MOST_FDS || connect(fd, (struct sockaddr *)&at, sizeof at) || ask(fd, &asked, &reply) < 0) {
        const int why = errno == ECONNREFUSED ? ENOENT : errno;
        REAL(close)(fd);
        return errno = why, -1;
    }
    ours[fd] = 1;
    return fd;
}

static int is_path(const char *path) {
    const char *fake = getenv("MANYHANDS_FAKE_EVDEV");
    return fake && path && !strcmp(path, fake);
}

#define OPEN(name)                                             \
    int name(const char *path, int flags, ...) {               \
        va_list rest;                                          \
        va_start(rest, flags);                                 \
        const mode_t mode = va_arg(rest, mode_t);              \
        va_end(rest);                                          \
        return is_path(path) ? opened(path) : REAL(name)(path, flags, mode); \
    }
OPEN(open)
OPEN(open64)

#define OPENAT(name)                                           \
    int name(int at, const char *path, int flags, ...) {       \
        va_list rest;                                          \
        va_start(rest, flags);                                 \
        const mode_t mode = va_arg(rest, mode_t);              \
        va_end(rest);                                          \
        return is_path(path) ? opened(path) : REAL(name)(at, path, flags, mode); \
    }
OPENAT(openat)
OPENAT(openat64)

int close(int fd) {
    if (is_ours(fd)) ours[fd] = 0;
    return REAL(close)(fd);
}

int ioctl(int fd, unsigned long request, ...) {
    va_list rest;
    va_start(rest, request);
    void *argument = va_arg(rest, void *);
    va_end(rest);
    if (!is_ours(fd)) return REAL(ioctl)(fd, request, argument);
    rpc_request asked = {.op = RPC_IOCTL, .request = request, .value = (int64_t)(intptr_t)argument};
    rpc_reply reply;
    const size_t size = _IOC_SIZE(request);
    const int number = request == 0x40044581 || request == 0x40044590; /* EVIOCRMFF, EVIOCGRAB */
    if (!number && size <= RPC_MOST) memcpy(asked.data, argument, asked.size = (uint32_t)size);
    const long result = ask(fd, &asked, &reply);
    if (result >= 0 && !number && reply.size) memcpy(argument, reply.data, reply.size);
    return (int)result;
}

ssize_t read(int fd, void *to, size_t size) {
    if (!is_ours(fd)) return REAL(read)(fd, to, size);
    rpc_request asked = {.op = RPC_READ, .request = size};
    rpc_reply reply;
    const long result = ask(fd, &asked, &reply);
    if (result > 0) memcpy(to, reply.data, reply.size);
    return result;
}

ssize_t write(int fd, const void *from, size_t size) {
    if (!is_ours(fd)) return REAL(write)(fd, from, size);
    rpc_request asked = {.op = RPC_WRITE, .size = (uint32_t)(size < RPC_MOST ? size : RPC_MOST)};
    rpc_reply reply;
    memcpy(asked.data, from, asked.size);
    return ask(fd, &asked, &reply);
}
