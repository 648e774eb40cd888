/* Preload library that runs Betaflight's simulator target in lockstep, on a virtual clock and without network ports.
 *
 * The firmware believes in a clock, sleeps, UDP packets and threads. Here the clock advances only by its own sleeps; its
 * threads are coroutines of one thread; a motor packet ends a step, and the next state arrives over one socket:
 *
 *     motor packet --> reply --> simulation --> request --> state and stick packets --> firmware
 *
 * Environment: LOCKSTEP_SOCKET is the number of the socket. LOCKSTEP_COMMANDS is a file of command lines that the firmware
 * reads as if from its first serial port; it answers on stdout. Without LOCKSTEP_SOCKET no states arrive.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <netinet/in.h>
#include <pthread.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <time.h>
#include <ucontext.h>
#include <unistd.h>

enum { MOTOR_PORT = 9001, STATE_PORT = 9003 }; /* Source: platform/SIMULATOR/sitl.c */
enum { CLOCK_READ_NS = 100, SERIAL_PERIOD_NS = 1000000, SERIAL_CHUNK = 32 };
enum { STEP = 0, KEEP = 1, RESTORE = 2 }; /* Kinds of request */
enum { SERIAL, STATES, STICKS, THREADS }; /* Threads in the order in which the firmware starts them */
enum { STACK = 1 << 17, RESTORED = 42, STEP_LIMIT_S = 30 };

struct request {
    uint32_t kind;
    uint32_t repeats;      /* Steps with this state and these sticks before the reply */
    double state[18];      /* fdm_packet: time, rates, specific force, attitude, velocity, position, pressure */
    uint16_t channels[16]; /* Of the transmitter [us] */
};
struct reply {
    uint64_t time_ns;   /* Virtual clock */
    float motors[16];   /* Pulses [us], in the firmware's order */
};
struct sticks { double time; uint16_t channels[16]; }; /* rc_packet */
struct motors { uint16_t count; float pulses[16]; };   /* servo_packet_raw */

static uint64_t now_ns = 1000000000, serial_due_ns;
static int link_fd = -1, state_fd = -1, listener = -1, console = -1, chunk_read;
static ucontext_t scheduler, threads[THREADS];
static int num_threads, current = -1, has_packet[THREADS], is_refused;
static void *(*routines[THREADS])(void *);
static char stacks[THREADS][STACK];
static struct request request;
static const char *commands;

__attribute__((constructor)) static void start(void)
{
    const char *number = getenv("LOCKSTEP_SOCKET");
    link_fd = number ? atoi(number) : -1;
    commands = getenv("LOCKSTEP_COMMANDS");
    alarm(STEP_LIMIT_S);
}

/* Threads */

static void run_routine(int which) { routines[which](NULL); }

static void resume(int which)
{
    if (which >= num_threads)
        return;
    current = which;
    swapcontext(&scheduler, &threads[which]);
    current = -1;
}

static void pause_thread(void)
{
    int which = current;
    swapcontext(&threads[which], &scheduler);
}

int pthread_create(pthread_t *thread, const pthread_attr_t *attributes, void *(*routine)(void *), void *argument)
{
    if (num_threads == THREADS)
        return EAGAIN;
    ucontext_t *context = &threads[num_threads];
    getcontext(context);
    context->uc_stack.ss_sp = stacks[num_threads];
    context->uc_stack.ss_size = STACK;
    context->uc_link = &scheduler;
    makecontext(context, (void (*)(void))run_routine, 1, num_threads);
    routines[num_threads] = routine;
    *thread = (pthread_t)num_threads++;
    return 0;
}

int pthread_join(pthread_t thread, void **result) { return 0; }

/* Clock */

int clock_gettime(clockid_t clock, struct timespec *time)
{
    now_ns += CLOCK_READ_NS; /* a loop that waits for a time reaches it */
    time->tv_sec = (time_t)(now_ns / 1000000000);
    time->tv_nsec = (long)(now_ns % 1000000000);
    return 0;
}

int nanosleep(const struct timespec *wanted, struct timespec *left)
{
    now_ns += (uint64_t)wanted->tv_sec * 1000000000 + (uint64_t)wanted->tv_nsec;
    if (commands && current < 0 && now_ns >= serial_due_ns) {
        serial_due_ns = now_ns + SERIAL_PERIOD_NS;
        resume(SERIAL);
    }
    return 0;
}

/* Exchange with the simulation */

static void send_reply(const struct motors *motors)
{
    struct reply reply = {.time_ns = now_ns};
    memcpy(reply.motors, motors->pulses, sizeof reply.motors);
    if (write(link_fd, &reply, sizeof reply) != sizeof reply)
        _exit(0);
}

/* Go on as a copy of this process, and start another copy whenever one ends with RESTORED. */
static void fork_copies(void)
{
    int status = RESTORED << 8;
    alarm(0);
    while (WIFEXITED(status) && WEXITSTATUS(status) == RESTORED) {
        pid_t parent = getpid(), copy = fork();
        if (copy == 0) {
            prctl(PR_SET_PDEATHSIG, SIGKILL);
            if (getppid() != parent)
                _exit(0);
            return;
        }
        if (copy < 0 || waitpid(copy, &status, 0) < 0)
            _exit(1);
    }
    if (WIFSIGNALED(status))
        raise(WTERMSIG(status));
    _exit(WEXITSTATUS(status));
}

static void end_step(const struct motors *motors)
{
    static uint32_t repeats;
    if (repeats > 0) {
        repeats--;
    } else {
        static int begun;
        if (begun)
            send_reply(motors);
        begun = 1;
        for (;;) {
            alarm(0);
            if (read(link_fd, &request, sizeof request) != sizeof request)
                _exit(0); /* the simulation has ended */
            alarm(STEP_LIMIT_S); /* ends a firmware that hangs, even without a simulation */
            if (request.kind == STEP)
                break;
            if (request.kind == RESTORE)
                _exit(RESTORED);
            fork_copies();
            send_reply(motors);
        }
        repeats = request.repeats - 1;
    }
    has_packet[STICKS] = 1;
    resume(STICKS);
    do { /* the firmware answers the first state after a pause of 0.5 s, but does not use it */
        is_refused = 0;
        has_packet[STATES] = 1;
        resume(STATES);
    } while (is_refused);
}

/* Sockets: UDP ports carry the exchange; TCP ports listen to nobody, or read the file of command lines. */

int socket(int domain, int type, int protocol) { return open("/dev/null", O_RDWR | O_CLOEXEC); }

int setsockopt(int fd, int level, int name, const void *value, socklen_t length) { return 0; }

int bind(int fd, const struct sockaddr *address, socklen_t length)
{
    if (ntohs(((const struct sockaddr_in *)address)->sin_port) == STATE_PORT)
        state_fd = fd;
    return 0;
}

int listen(int fd, int backlog)
{
    if (listener < 0)
        listener = fd;
    return 0;
}

int accept(int fd, struct sockaddr *address, socklen_t *length)
{
    if (fd == listener && console < 0)
        return console = open(commands, O_RDONLY | O_CLOEXEC);
    errno = EWOULDBLOCK;
    return -1;
}

int select(int count, fd_set *readable, fd_set *writable, fd_set *failed, struct timeval *timeout)
{
    if (current != SERIAL) {
        while (!has_packet[current])
            pause_thread();
        return 1;
    }
    pause_thread();
    chunk_read = 0;
    for (int fd = 0; readable && fd < count; fd++)
        if (fd != console && !(fd == listener && console < 0))
            FD_CLR(fd, readable);
    return 1;
}

ssize_t recv(int fd, void *data, size_t size, int flags)
{
    ssize_t count = chunk_read ? 0 : read(fd, data, size < SERIAL_CHUNK ? size : SERIAL_CHUNK);
    chunk_read = 1;
    if (count > 0)
        return count;
    errno = EWOULDBLOCK;
    return -1;
}

ssize_t send(int fd, const void *data, size_t size, int flags) { return (ssize_t)fwrite(data, 1, size, stdout); }

ssize_t recvfrom(int fd, void *data, size_t size, int flags, struct sockaddr *address, socklen_t *length)
{
    int which = fd == state_fd ? STATES : STICKS;
    struct sticks sticks = {0};
    memcpy(sticks.channels, request.channels, sizeof sticks.channels);
    const void *packet = which == STATES ? (const void *)request.state : (const void *)&sticks;
    size_t known = which == STATES ? sizeof request.state : sizeof sticks;
    memcpy(data, packet, size < known ? size : known);
    has_packet[which] = 0;
    return (ssize_t)known;
}

ssize_t sendto(int fd, const void *data, size_t size, int flags, const struct sockaddr *address, socklen_t length)
{
    is_refused = current == STATES;
    if (link_fd >= 0 && ntohs(((const struct sockaddr_in *)address)->sin_port) == MOTOR_PORT)
        end_step(data);
    return (ssize_t)size;
}
