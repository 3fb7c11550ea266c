/* What a process asks the fake kernel of wheel.c, a packet each way over a socket of packets that is its descriptor. */
#ifndef EVDEV_RPC_H
#define EVDEV_RPC_H
#include <stdint.h>

enum { RPC_OPEN = 1, RPC_IOCTL, RPC_READ, RPC_WRITE };

#define RPC_MOST 2048

typedef struct {
    uint32_t op, size;     /* size of the data that follow */
    uint64_t request;      /* of an ioctl; the wanted bytes of a read */
    int64_t value;         /* of an ioctl whose argument is a number */
    uint8_t data[RPC_MOST];
} rpc_request;

typedef struct {
    int64_t result; /* or -errno */
    uint32_t size, zero;
    uint8_t data[RPC_MOST];
} rpc_reply;

#define RPC_ASKED 24
#define RPC_ANSWERED 16
#endif
