/* A planner: reads forecasts where the worker has written them, and stops relying on them when the
 worker ends.
 *
 *     ./planner fleet.toml [FRAMES]     ends after so many frames, by Ctrl-C, or after ten seconds
 *     without any
 */
#include <inttypes.h>
#include <joulebus.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>

static const uint64_t TIMEOUT_NS = 1000ull * 1000 * 1000;
static const int MAX_SILENT = 10;

static volatile sig_atomic_t stop;

/* A signal ends the wait. One that comes between two waits is seen before the next. */
static void on_signal(int signal_number) {
    (void)signal_number;
    stop = 1;
}

static int failed(const char *what) {
    fprintf(stderr, "%s: %s\n", what, joulebus_last_error());
    return EXIT_FAILURE;
}

static void print_frame(joulebus_subscriber *subscriber, const joulebus_forecasts *frame) {
    double total_w = 0.0;
    size_t known = 0;
    for (size_t at = 0; at < frame->count; at++) {
        const joulebus_forecast *robot = &frame->robots[at];
        if (robot->flags & JOULEBUS_FORECAST_POWER) {
            total_w += robot->power_w;
            known++;
        }
    }
    printf("tick %" PRIu64 ": %zu of %zu robots will draw %.2f W", frame->header->tick, known, frame->count, total_w);
    const joulebus_forecast *seventh = NULL;
    if (!joulebus_subscriber_robot(subscriber, 7, &seventh) && seventh && seventh->flags & JOULEBUS_FORECAST_INTERVAL) {
        printf(", robot 7 %.2f to %.2f W", seventh->lo_w, seventh->hi_w);
    }
    printf("\n");
    fflush(stdout);
}

int main(int count, char **arguments) {
    if (count < 2) {
        fprintf(stderr, "usage: %s CONFIG [FRAMES]\n", arguments[0]);
        return 2;
    }
    unsigned long frames = count > 2 ? strtoul(arguments[2], NULL, 10) : 0;
    signal(SIGINT, on_signal);
    signal(SIGTERM, on_signal);
    joulebus_subscriber *subscriber = NULL;
    if (joulebus_subscriber_open(JOULEBUS_HEADER, arguments[1], "planner", &subscriber)) {
        return failed("cannot join the fleet");
    }
    unsigned long seen = 0;
    int ends = 0, silent = 0;
    while (!stop && !ends && (frames == 0 || seen < frames)) {
        joulebus_event event;
        if (joulebus_subscriber_wait(subscriber, TIMEOUT_NS, &event)) {
            /* The next call may succeed. */
            fprintf(stderr, "%s\n", joulebus_last_error());
            continue;
        }
        switch (event.kind) {
        case JOULEBUS_EVENT_KIND_FRAME:
            print_frame(subscriber, &event.frame);
            seen++;
            silent = 0;
            break;
        case JOULEBUS_EVENT_KIND_GONE:
            printf("the worker has ended (%u): do not rely on forecasts\n", (unsigned)event.end);
            fflush(stdout);
            break;
        case JOULEBUS_EVENT_KIND_STALE:
            printf("no frame for %.3f s: do not rely on forecasts\n", 1e-9 * (double)event.age_ns);
            fflush(stdout);
            break;
        case JOULEBUS_EVENT_KIND_TIMED_OUT:
            printf("no forecasts: does a worker run, and does a controller publish?\n");
            fflush(stdout);
            ends = ++silent == MAX_SILENT;
            break;
        default:
            ends = 1;
            break;
        }
    }
    joulebus_subscriber_status status;
    if (joulebus_subscriber_get_status(subscriber, &status)) {
        return failed("status");
    }
    printf("%" PRIu64 " frames, %" PRIu64 " ticks missed, %" PRIu64 " workers\n", status.frames, status.ticks_missed,
           status.workers);
    if (joulebus_subscriber_close(subscriber)) {
        return failed("close");
    }
    return EXIT_SUCCESS;
}
