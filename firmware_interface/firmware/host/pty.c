/* The board as a process on a pseudo-terminal, in real time: the serial path without a board.
 *
 *     pty CONFIG FIRMWARE_ID BOOT_NONCE LINK
 *
 * CONFIG is the limits record in hexadecimal; LINK becomes a symbolic link to the terminal. With
 * fd:N for LINK there is no terminal: the line is the socket that was inherited as number N, whose
 * bytes no thread of the kernel has to move. On standard input, a line each, answered by "ok" on standard output:
 *
 *     sense MV PA    what the sensors say from now on
 *     down           power fails: what is under way on the line is lost
 *     up CAUSE       power is back; the clock starts at 0
 *
 * The process ends when its input ends, when its parent is gone, or on SIGTERM, so that none
 * outlives whoever started it.
 */
#define _GNU_SOURCE /* ppoll */
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "abt_firmware.h"

#define LINE_MAX_SIZE 128u
#define LINK_MAX_SIZE 4000u

typedef struct {
    abt_firmware firmware;
    abt_config config;
    abt_identity identity;
    abt_sensors sensors;
    abt_outputs outputs;
    bool powered;
    struct timespec power_on;
    int line; /* our end of the terminal */
    int other; /* its other end, kept open so that reading never fails; -1: the line is a socket */
    uint8_t unsent[ABT_FRAME_MAX];
    size_t unsent_count;
    char order[LINE_MAX_SIZE];
    size_t order_size;
} board;

static volatile sig_atomic_t ended;

static void end(int number)
{
    (void)number;
    ended = 1;
}

static void alone(void *context) /* one thread: nothing can come between */
{
    (void)context;
}

static void die(const char *what)
{
    fprintf(stderr, "pty: %s: %s\n", what, strerror(errno));
    exit(1);
}

static uint32_t now_us(const board *b)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    const int64_t seconds = (int64_t)now.tv_sec - (int64_t)b->power_on.tv_sec;
    const int64_t ns = (int64_t)now.tv_nsec - (int64_t)b->power_on.tv_nsec;
    return (uint32_t)(seconds * 1000000 + ns / 1000);
}

static void run(board *b)
{
    b->outputs = abt_run(&b->firmware, now_us(b), b->sensors);
}

static void power_up(board *b, abt_reset_cause cause)
{
    b->identity.reset_cause = cause;
    b->powered = true;
    clock_gettime(CLOCK_MONOTONIC, &b->power_on);
    abt_init(&b->firmware, &b->config, &b->identity, (abt_port){alone, alone, NULL}, 0);
    run(b);
}

static void power_down(board *b)
{
    b->powered = false;
    b->identity.boot_nonce++;
    b->unsent_count = 0;
    if (b->other >= 0) {
        tcflush(b->other, TCIOFLUSH);
        tcflush(b->line, TCIOFLUSH);
        return;
    }
    uint8_t lost[256];
    while (read(b->line, lost, sizeof lost) > 0) {
    }
}

/* ---- Orders of the parent ----------------------------------------------------------------- */

static void obey(board *b)
{
    unsigned long first = 0, second = 0;
    if (sscanf(b->order, "sense %lu %lu", &first, &second) == 2) {
        b->sensors = (abt_sensors){(uint16_t)first, (uint32_t)second};
        if (b->powered) {
            run(b);
        }
    } else if (sscanf(b->order, "up %lu", &first) == 1) {
        power_up(b, (abt_reset_cause)first);
    } else if (strcmp(b->order, "down") == 0) {
        power_down(b);
    } else {
        fprintf(stderr, "pty: no such order: %s\n", b->order);
        exit(1);
    }
    puts("ok");
    fflush(stdout);
}

static void hear_parent(board *b)
{
    char bytes[LINE_MAX_SIZE];
    const ssize_t count = read(STDIN_FILENO, bytes, sizeof bytes);
    if (count <= 0) {
        ended = 1;
    }
    for (ssize_t i = 0; i < count; i++) {
        if (bytes[i] == '\n') {
            b->order[b->order_size] = '\0';
            b->order_size = 0;
            obey(b);
        } else if (b->order_size + 1u < LINE_MAX_SIZE) {
            b->order[b->order_size++] = bytes[i];
        }
    }
}

/* ---- The line ----------------------------------------------------------------------------- */

static void hear_line(board *b)
{
    uint8_t bytes[256];
    const ssize_t count = read(b->line, bytes, sizeof bytes);
    if (count == 0 && b->other < 0) { /* whoever had the other end of the socket is gone */
        ended = 1;
    }
    if (count > 0 && b->powered &&
        abt_receive(&b->firmware, now_us(b), bytes, (size_t)count)) {
        run(b);
    }
}

/* Frames out as far as the line takes them. */
static void talk(board *b)
{
    for (;;) {
        if (b->unsent_count == 0 && b->powered) {
            b->unsent_count = abt_transmit(&b->firmware, now_us(b), b->unsent);
        }
        if (b->unsent_count == 0) {
            return;
        }
        const ssize_t count = write(b->line, b->unsent, b->unsent_count);
        if (count <= 0) {
            return;
        }
        b->unsent_count -= (size_t)count;
        memmove(b->unsent, b->unsent + count, b->unsent_count);
    }
}

static void open_line(board *b)
{
    struct termios raw;
    b->line = posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC);
    if (b->line < 0 || grantpt(b->line) || unlockpt(b->line)) {
        die("no pseudo-terminal");
    }
    b->other = open(ptsname(b->line), O_RDWR | O_NOCTTY | O_CLOEXEC);
    if (b->other < 0 || tcgetattr(b->other, &raw)) {
        die(ptsname(b->line));
    }
    cfmakeraw(&raw);
    tcsetattr(b->other, TCSANOW, &raw);
}

static void take_line(board *b, const char *number)
{
    b->line = (int)strtol(number, NULL, 10);
    b->other = -1;
    if (fcntl(b->line, F_SETFL, O_NONBLOCK)) {
        die("no such line");
    }
}

/* ---- Process ------------------------------------------------------------------------------ */

/* The link appears at once and complete, whatever was there before. */
static void make_link(const char *terminal, const char *link)
{
    char fresh[LINK_MAX_SIZE + 16u];
    snprintf(fresh, sizeof fresh, "%s.%ld", link, (long)getpid());
    if (strlen(link) > LINK_MAX_SIZE || symlink(terminal, fresh) || rename(fresh, link)) {
        die(link);
    }
}

static void remove_link(const char *terminal, const char *link)
{
    char found[LINK_MAX_SIZE];
    const ssize_t size = readlink(link, found, sizeof found - 1u);
    if (size > 0 && (size_t)size == strlen(terminal) && !strncmp(found, terminal, (size_t)size)) {
        unlink(link);
    }
}

static void serve(board *b)
{
    const pid_t parent = getppid();
    while (!ended && getppid() == parent) {
        struct pollfd watched[2] = {
            {.fd = STDIN_FILENO, .events = POLLIN},
            {.fd = b->line, .events = (short)(POLLIN | (b->unsent_count ? POLLOUT : 0))},
        };
        const uint32_t ahead_us = b->powered ? b->outputs.wake_us - now_us(b) : 100000u;
        const long wait_us = ahead_us > 100000u ? 0 : (long)ahead_us; /* above: it is past */
        const struct timespec wait = {0, wait_us * 1000};
        if (ppoll(watched, 2, &wait, NULL) < 0 && errno != EINTR) {
            die("ppoll");
        }
        hear_line(b); /* first: this process may have been kept waiting, the sender was not silent */
        if (b->powered && abt_reached(now_us(b), b->outputs.wake_us)) {
            run(b);
        }
        if (watched[0].revents) {
            hear_parent(b);
        }
        talk(b);
    }
}

static void read_config(const char *hex, abt_config *config)
{
    uint8_t record[ABT_CONFIG_SIZE];
    for (size_t i = 0; i < ABT_CONFIG_SIZE; i++) {
        unsigned byte = 0;
        if (sscanf(hex + 2 * i, "%2x", &byte) != 1) {
            fprintf(stderr, "pty: the limits record is %u bytes in hexadecimal\n", ABT_CONFIG_SIZE);
            exit(1);
        }
        record[i] = (uint8_t)byte;
    }
    abt_config_unpack(record, config);
}

int main(int count, char **argument)
{
    static board b;
    if (count != 5 || strlen(argument[1]) != 2 * ABT_CONFIG_SIZE) {
        fprintf(stderr, "usage: pty CONFIG FIRMWARE_ID BOOT_NONCE LINK\n");
        return 1;
    }
    signal(SIGTERM, end);
    signal(SIGHUP, end);
    signal(SIGPIPE, SIG_IGN);
    read_config(argument[1], &b.config);
    b.identity.firmware_id = (uint32_t)strtoul(argument[2], NULL, 0);
    b.identity.boot_nonce = (uint32_t)strtoul(argument[3], NULL, 0);
    b.sensors = (abt_sensors){24000, 500000};
    const bool inherited = strncmp(argument[4], "fd:", 3) == 0;
    const char *terminal = NULL;
    if (inherited) {
        take_line(&b, argument[4] + 3);
    } else {
        open_line(&b);
        terminal = ptsname(b.line);
        make_link(terminal, argument[4]);
    }
    power_up(&b, ABT_RESET_CAUSE_POWER_ON);
    puts("ok");
    fflush(stdout);
    serve(&b);
    if (!inherited) {
        remove_link(terminal, argument[4]);
    }
    return 0;
}
