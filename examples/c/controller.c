/* A fleet controller: publishes what it commands and what it measures, 30 times a second.
 *
 *     ./controller fleet.toml [FRAMES]          without FRAMES until Ctrl-C
 */
#include <errno.h>
#include <inttypes.h>
#include <joulebus.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

enum { ROBOTS = 8 };
static const uint64_t PERIOD_NS = 33333333;

static volatile sig_atomic_t stop = 0;

static void on_signal(int signal_number) {
    (void)signal_number;
    stop = 1;
}

static int failed(const char *what) {
    fprintf(stderr, "%s: %s\n", what, joulebus_last_error());
    return EXIT_FAILURE;
}

/* Sleeps until a time of the clock that joulebus stamps with. */
static void sleep_until(uint64_t due_ns) {
    struct timespec due = {(time_t)(due_ns / 1000000000), (long)(due_ns % 1000000000)};
    while (!stop && clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, NULL) == EINTR) {
    }
}

int main(int count, char **arguments) {
    if (count < 2) {
        fprintf(stderr, "usage: %s CONFIG [FRAMES]\n", arguments[0]);
        return 2;
    }
    unsigned long frames = count > 2 ? strtoul(arguments[2], NULL, 10) : 0;
    signal(SIGINT, on_signal);
    signal(SIGTERM, on_signal);

    joulebus_publisher *publisher = NULL;
    if (joulebus_publisher_open(JOULEBUS_HEADER, arguments[1], "example-c", &publisher)) {
        return failed("cannot join the fleet");
    }
    uint64_t due_ns = joulebus_monotonic_ns();
    for (unsigned long frame = 0; !stop && (frames == 0 || frame < frames); frame++) {
        joulebus_robot_state robots[ROBOTS] = {{0}};
        for (uint32_t robot = 0; robot < ROBOTS; robot++) {
            robots[robot].robot = robot;
            robots[robot].flags = JOULEBUS_SAMPLE_V | JOULEBUS_SAMPLE_OMEGA | JOULEBUS_SAMPLE_POWER;
            robots[robot].v_mps = 0.1f;
            robots[robot].omega_radps = 0.0f;
            /* What your power monitor says. Here it is near what such a robot draws. */
            robots[robot].power_w = 4.0f + 0.02f * (float)((frame + robot) % 7);
        }
        const joulebus_error error = joulebus_publisher_publish(publisher, robots, ROBOTS, due_ns, NULL);
        if (error == JOULEBUS_ERROR_CONNECT) {
            /* Files of this process were removed. */
            return failed("not sent");
        }
        if (error) {
            /* The publisher remains usable. */
            fprintf(stderr, "not sent: %s\n", joulebus_last_error());
        }
        due_ns += PERIOD_NS;
        sleep_until(due_ns);
    }
    joulebus_publisher_counts counts;
    if (joulebus_publisher_get_counts(publisher, &counts)) {
        return failed("counts");
    }
    printf("%" PRIu64 " frames, %" PRIu64 " samples\n", counts.frames_sent, counts.samples_sent);
    if (joulebus_publisher_close(publisher)) {
        return failed("close");
    }
    return EXIT_SUCCESS;
}
