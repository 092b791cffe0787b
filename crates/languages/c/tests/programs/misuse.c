/* What a C program may get wrong: each call is refused with its code and a message, and the next
 * one works. Beside a running worker and a source of robots 0 to 7:
 *
 *     ./misuse fleet.toml
 */
#include <joulebus.h>
#include <math.h>
#include <pthread.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

static int checks = 0;

static void check(int line, int found, int expected, const char *says) {
    const char *text = joulebus_last_error();
    if (found != expected || (expected && !strstr(text ? text : "", says))) {
        fprintf(stderr, "line %d: %s (%d), expected %s saying %s: %s\n", line, joulebus_error_name(found), found,
                joulebus_error_name(expected), says, text ? text : "no message");
        exit(EXIT_FAILURE);
    }
    checks++;
}
#define OK(call) check(__LINE__, (call), JOULEBUS_ERROR_NONE, "")
#define REFUSED(call, code, says) check(__LINE__, (call), JOULEBUS_ERROR_##code, (says))
#define HOLDS(condition) check(__LINE__, !(condition), 0, #condition)

static const uint64_t PATIENCE_NS = 120ull * 1000 * 1000 * 1000;
static const char *config;

static joulebus_publisher *publisher(const char *name) {
    joulebus_publisher *opened = NULL;
    OK(joulebus_publisher_open(JOULEBUS_HEADER, config, name, &opened));
    return opened;
}

static joulebus_subscriber *subscriber(void) {
    joulebus_subscriber *opened = NULL;
    OK(joulebus_subscriber_open(JOULEBUS_HEADER, config, "misuse", &opened));
    return opened;
}

static joulebus_forecasts next_frame(joulebus_subscriber *from) {
    for (;;) {
        joulebus_event event;
        OK(joulebus_subscriber_wait(from, PATIENCE_NS, &event));
        HOLDS(event.kind != JOULEBUS_EVENT_KIND_TIMED_OUT);
        if (event.kind == JOULEBUS_EVENT_KIND_FRAME && event.frame.count >= 8) {
            return event.frame;
        }
    }
}

/*
 * Waits until the worker has dropped a sample for this reason: of a source that leaves at once it
 * need not take any.
 */
static void until_counted(uint32_t reason) {
    joulebus_subscriber *seen = subscriber();
    for (int frames = 0; next_frame(seen).header->samples_dropped.counts[reason] == 0; frames++) {
        HOLDS(frames < 3000);
    }
    OK(joulebus_subscriber_close(seen));
}

static void versions_and_pointers(void) {
    HOLDS(joulebus_last_error() == NULL);
    HOLDS(!strcmp(joulebus_version(), JOULEBUS_VERSION));
    HOLDS(joulebus_schema_version() == JOULEBUS_SCHEMA_VERSION);
    OK(joulebus_check_version(JOULEBUS_HEADER));
    REFUSED(joulebus_check_version("0.0.9, schema 1"), VERSION, "0.0.9, schema 1");
    REFUSED(joulebus_check_version("0.0.9, schema 1"), VERSION, JOULEBUS_HEADER);
    REFUSED(joulebus_check_version(NULL), ARGUMENT, "header is NULL");
    joulebus_publisher *one = NULL;
    REFUSED(joulebus_publisher_open("9.9.9, schema 4", config, "one", &one), VERSION, "install");
    REFUSED(joulebus_publisher_open(JOULEBUS_HEADER, NULL, "one", &one), ARGUMENT, "config_path is NULL");
    REFUSED(joulebus_publisher_open(JOULEBUS_HEADER, config, NULL, &one), ARGUMENT, "source_name is NULL");
    REFUSED(joulebus_publisher_open(JOULEBUS_HEADER, config, "one", NULL), ARGUMENT, "publisher is NULL");
    REFUSED(joulebus_publisher_open(JOULEBUS_HEADER, "/no/such.toml", "one", &one), CONNECT, "/no/such.toml");
    REFUSED(joulebus_publisher_open(JOULEBUS_HEADER, config, "", &one), CONNECT, "name");
    REFUSED(joulebus_publisher_open(JOULEBUS_HEADER, config, "\xff\xfe", &one), ARGUMENT, "UTF-8");
    HOLDS(one == NULL);
}

static void publishing(void) {
    joulebus_publisher *one = publisher("misuse");
    joulebus_robot_state robots[4] = {{0}};
    for (uint32_t robot = 0; robot < 4; robot++) {
        robots[robot].robot = 90 + robot;
        robots[robot].flags = JOULEBUS_SAMPLE_POWER;
        robots[robot].power_w = 4.0f;
    }
    joulebus_sent sent = {0};
    OK(joulebus_publisher_publish(one, robots, 4, 0, &sent));
    HOLDS(sent.samples == 4 && sent.frame_seq == 0);
    OK(joulebus_publisher_publish(one, robots, 4, joulebus_monotonic_ns(), NULL));
    OK(joulebus_publisher_publish(one, NULL, 0, 0, NULL));
    REFUSED(joulebus_publisher_publish(one, NULL, 4, 0, NULL), ARGUMENT, "robots is NULL");
    REFUSED(joulebus_publisher_publish(one, robots, SIZE_MAX, 0, NULL), ARGUMENT, "no memory holds");
    REFUSED(joulebus_publisher_publish(one, robots, SIZE_MAX / 2, 0, NULL), ARGUMENT, "no memory holds");
    REFUSED(joulebus_publisher_publish(one, (void *)((char *)robots + 1), 2, 0, NULL), ARGUMENT, "multiple of 8");
    REFUSED(joulebus_publisher_publish(NULL, robots, 4, 0, NULL), ARGUMENT, "publisher is NULL");
    robots[2].robot = 90;
    REFUSED(joulebus_publisher_publish(one, robots, 4, 0, NULL), PUBLISH, "robot 90 is in the frame twice");
    robots[2].robot = 92;
    robots[1].flags = JOULEBUS_SAMPLE_DISCONTINUITY;
    REFUSED(joulebus_publisher_publish(one, robots, 4, 0, NULL), ARGUMENT, "flags of robot 91");
    robots[1].flags = JOULEBUS_SAMPLE_POWER;
    joulebus_publisher_counts counts;
    OK(joulebus_publisher_get_counts(one, &counts));
    HOLDS(counts.frames_sent == 3 && counts.samples_sent == 8);
    joulebus_not_taken not_taken;
    OK(joulebus_publisher_get_not_taken(one, &not_taken));
    HOLDS(not_taken.count == 0 && not_taken.text[0] == 0);
    REFUSED(joulebus_publisher_get_not_taken(one, NULL), ARGUMENT, "not_taken is NULL");
    size_t many = counts.capacity + 1;
    joulebus_robot_state *crowd = calloc(many, sizeof *crowd);
    for (size_t robot = 0; robot < many; robot++) {
        crowd[robot].robot = (uint32_t)robot;
    }
    REFUSED(joulebus_publisher_publish(one, crowd, many, 0, NULL), PUBLISH, "fleet.capacity");
    free(crowd);
    /* Sent, and refused by the worker: the other robots are not affected. */
    robots[1].power_w = NAN;
    OK(joulebus_publisher_publish(one, robots, 4, 0, &sent));
    joulebus_sample samples[1] = {{.robot = 95, .flags = JOULEBUS_SAMPLE_POWER, .stamp_ns = joulebus_monotonic_ns()}};
    OK(joulebus_publisher_publish_samples(one, samples, 1, 0, NULL));
    until_counted(JOULEBUS_DROP_NOT_FINITE);
    OK(joulebus_publisher_close(one));
}

static void closed_handles(void) {
    joulebus_publisher *one = publisher("closed");
    OK(joulebus_publisher_close(one));
    REFUSED(joulebus_publisher_close(one), HANDLE, "the publisher is closed");
    REFUSED(joulebus_publisher_publish(one, NULL, 0, 0, NULL), HANDLE, "the publisher is closed");
    joulebus_publisher *two = publisher("closed");
    HOLDS(one != two);
    REFUSED(joulebus_publisher_publish(one, NULL, 0, 0, NULL), HANDLE, "the publisher is closed");
    joulebus_event event;
    REFUSED(joulebus_subscriber_wait((joulebus_subscriber *)two, 0, &event), HANDLE, "not a subscriber");
    int on_the_stack = 0;
    REFUSED(joulebus_publisher_close((joulebus_publisher *)&on_the_stack), HANDLE, "not a publisher");
    REFUSED(joulebus_publisher_close((joulebus_publisher *)(intptr_t)-1), HANDLE, "not a publisher");
    OK(joulebus_publisher_close(two));
    OK(joulebus_publisher_close(NULL));
    OK(joulebus_subscriber_close(NULL));
    OK(joulebus_frame_close(NULL));
    OK(joulebus_questions_close(NULL));
    OK(joulebus_client_close(NULL));
    OK(joulebus_predictor_close(NULL));
}

struct shared {
    joulebus_publisher *publisher;
    joulebus_subscriber *subscriber;
    joulebus_frame *frame;
    joulebus_predictor *predictor;
};

static void *in_another_thread(void *given) {
    struct shared *shared = given;
    joulebus_event event;
    HOLDS(joulebus_last_error() == NULL);
    REFUSED(joulebus_publisher_publish(shared->publisher, NULL, 0, 0, NULL), THREAD, "belongs to the thread");
    REFUSED(joulebus_publisher_close(shared->publisher), THREAD, "belongs to the thread");
    REFUSED(joulebus_subscriber_wait(shared->subscriber, 0, &event), THREAD, "belongs to the thread");
    REFUSED(joulebus_subscriber_close(shared->subscriber), THREAD, "belongs to the thread");
    REFUSED(joulebus_frame_close(shared->frame), THREAD, "belongs to the thread");
    /* Its own are its own. */
    joulebus_subscriber *own = subscriber();
    OK(joulebus_subscriber_wait(own, 0, &event));
    OK(joulebus_subscriber_close(own));
    float features[13] = {0}, power_w = 0;
    for (int call = 0; call < 1000; call++) {
        OK(joulebus_predictor_predict(shared->predictor, features, 1, 13, &power_w));
    }
    return NULL;
}

static volatile int stopping = 0;

/* Is in the library's locks at most moments. */
static void *in_locks(void *given) {
    const struct shared *shared = given;
    while (!stopping) {
        uint64_t hash = 0;
        for (int call = 0; call < 1000; call++) {
            joulebus_predictor_hash(shared->predictor, &hash);
        }
        joulebus_subscriber *own = NULL;
        if (!joulebus_subscriber_open(JOULEBUS_HEADER, config, "misuse", &own)) {
            joulebus_subscriber_close(own);
        }
    }
    return NULL;
}

/* A child opens new handles, whatever other threads did at the fork. */
static void in_children_of_a_busy_process(struct shared *shared) {
    pthread_t thread;
    HOLDS(!pthread_create(&thread, NULL, in_locks, shared));
    for (int number = 0; number < 40; number++) {
        pid_t child = fork();
        HOLDS(child >= 0);
        if (child == 0) {
            /* One that hangs is ended by this. */
            alarm(100);
            joulebus_predictor *predictor = NULL;
            OK(joulebus_predictor_open(JOULEBUS_HEADER, NULL, &predictor));
            OK(joulebus_predictor_close(predictor));
            if (number % 4 == 0) {
                joulebus_subscriber *own = subscriber();
                OK(joulebus_subscriber_close(own));
            }
            execl("/bin/sh", "sh", "-c", "exit 7", (char *)NULL);
            _exit(1);
        }
        int status = 0;
        HOLDS(waitpid(child, &status, 0) == child && WIFEXITED(status) && WEXITSTATUS(status) == 7);
    }
    stopping = 1;
    HOLDS(!pthread_join(thread, NULL));
}

static void in_a_child(struct shared *shared) {
    pid_t child = fork();
    HOLDS(child >= 0);
    if (child == 0) {
        joulebus_event event;
        REFUSED(joulebus_publisher_publish(shared->publisher, NULL, 0, 0, NULL), PROCESS, "forked");
        REFUSED(joulebus_subscriber_wait(shared->subscriber, 0, &event), PROCESS, "forked");
        REFUSED(joulebus_subscriber_close(shared->subscriber), PROCESS, "forked");
        REFUSED(joulebus_frame_close(shared->frame), PROCESS, "forked");
        float features[13] = {0}, power_w = 0;
        REFUSED(joulebus_predictor_predict(shared->predictor, features, 1, 13, &power_w), PROCESS, "forked");
        REFUSED(joulebus_predictor_close(shared->predictor), PROCESS, "forked");
        joulebus_subscriber *own = subscriber();
        next_frame(own);
        OK(joulebus_subscriber_close(own));
        /* Not _exit: valgrind would miss what belonged to the parent's threads. */
        execl("/bin/sh", "sh", "-c", "exit 7", (char *)NULL);
        _exit(1);
    }
    int status = 0;
    HOLDS(waitpid(child, &status, 0) == child && WIFEXITED(status) && WEXITSTATUS(status) == 7);
}

static void threads_and_processes(void) {
    struct shared shared = {publisher("shared"), subscriber(), NULL, NULL};
    OK(joulebus_predictor_open(JOULEBUS_HEADER, NULL, &shared.predictor));
    next_frame(shared.subscriber);
    OK(joulebus_subscriber_take_current(shared.subscriber, &shared.frame, NULL));
    pthread_t threads[4];
    for (int number = 0; number < 4; number++) {
        HOLDS(!pthread_create(&threads[number], NULL, in_another_thread, &shared));
    }
    for (int number = 0; number < 4; number++) {
        HOLDS(!pthread_join(threads[number], NULL));
    }
    in_a_child(&shared);
/* AddressSanitizer's allocator of GCC before 15 does not release its locks in a child: a fork while
   another thread allocates can hang there, in memory that is not the library's. */
#ifndef __SANITIZE_ADDRESS__
    in_children_of_a_busy_process(&shared);
#else
    (void)in_children_of_a_busy_process;
#endif
    /* Nobody has closed or disturbed them. */
    next_frame(shared.subscriber);
    OK(joulebus_publisher_publish(shared.publisher, NULL, 0, 0, NULL));
    OK(joulebus_frame_close(shared.frame));
    OK(joulebus_subscriber_close(shared.subscriber));
    OK(joulebus_publisher_close(shared.publisher));
    OK(joulebus_predictor_close(shared.predictor));
    REFUSED(joulebus_predictor_close(shared.predictor), HANDLE, "the predictor is closed");
}

static void frames(void) {
    joulebus_subscriber *one = subscriber();
    joulebus_frame *kept[3] = {NULL};
    joulebus_forecasts views[3];
    REFUSED(joulebus_subscriber_take_current(one, &kept[0], NULL), NO_FRAME, "no frame to take");
    const joulebus_forecast *row = NULL;
    joulebus_forecasts frame = next_frame(one);
    OK(joulebus_subscriber_robot(one, 7, &row));
    HOLDS(row && row->robot == 7 && row >= frame.robots && row < frame.robots + frame.count);
    OK(joulebus_subscriber_robot(one, 4000000000u, &row));
    HOLDS(row == NULL);
    for (int number = 0; number < 2; number++) {
        OK(joulebus_subscriber_take_current(one, &kept[number], &views[number]));
        REFUSED(joulebus_subscriber_take_current(one, &kept[2], NULL), NO_FRAME, "taken already");
        next_frame(one);
    }
    OK(joulebus_subscriber_take_current(one, &kept[2], &views[2]));
    HOLDS(views[0].header->tick < views[1].header->tick && views[1].header->tick < views[2].header->tick);
    /* With three, the next read that finds a frame is refused. */
    joulebus_event event = {.kind = JOULEBUS_EVENT_KIND_TIMED_OUT};
    int refused = 0;
    while (!(refused = joulebus_subscriber_wait(one, PATIENCE_NS, &event)) && event.kind != JOULEBUS_EVENT_KIND_TIMED_OUT) {
    }
    REFUSED(refused, READ, "");
    OK(joulebus_frame_close(kept[1]));
    next_frame(one);
    joulebus_diagnostics diagnostics = {0};
    joulebus_budgets budgets = {0};
    while (!diagnostics.header || !budgets.header) {
        OK(joulebus_subscriber_diagnostics(one, &diagnostics));
        OK(joulebus_subscriber_budgets(one, &budgets));
        usleep(2000);
    }
    HOLDS(budgets.count >= 8 && diagnostics.count >= 8);
    joulebus_subscriber_status status;
    OK(joulebus_subscriber_get_status(one, &status));
    HOLDS(status.frames >= 4 && status.workers == 1);
    /* What is kept stays as it is, byte by byte: 33 ticks after the subscriber was closed, memory
     * that was given back has been written to. */
    const size_t bytes = views[0].count * sizeof(*views[0].robots);
    const joulebus_forecast_header header = *views[0].header;
    void *robots = malloc(bytes);
    HOLDS(robots != NULL && views[0].count >= 8);
    memcpy(robots, views[0].robots, bytes);
    joulebus_subscriber *later = subscriber();
    OK(joulebus_subscriber_close(one));
    for (uint64_t tick = next_frame(later).header->tick + 40; next_frame(later).header->tick < tick;) {
    }
    HOLDS(!memcmp(&header, views[0].header, sizeof(header)) && !memcmp(robots, views[0].robots, bytes));
    free(robots);
    OK(joulebus_subscriber_close(later));
    OK(joulebus_frame_close(kept[0]));
    REFUSED(joulebus_frame_close(kept[0]), HANDLE, "the frame is closed");
    OK(joulebus_frame_close(kept[2]));
}

static joulebus_questions *questions(void) {
    joulebus_questions *asked = NULL;
    OK(joulebus_questions_open(JOULEBUS_HEADER, config, "misuse", &asked));
    uint64_t tick = 0, age_ns = 0;
    OK(joulebus_questions_wait(asked, PATIENCE_NS, &tick, &age_ns));
    HOLDS(tick > 0);
    /* Until robot 7 has been seen. */
    float rest[3] = {0};
    joulebus_answer_row answer;
    int error = JOULEBUS_ERROR_NONE;
    do {
        usleep(10000);
        error = joulebus_questions_what_if(asked, 7, 1, 3, 0.1f, rest, rest, 0.9f, &answer, NULL);
    } while (error == JOULEBUS_ERROR_QUESTION);
    OK(error);
    return asked;
}

static void plans(void) {
    joulebus_questions *asked = questions();
    float v[4] = {0.1f, 0.1f, 0.0f, 0.0f}, omega[4] = {0}, power_w[4];
    joulebus_answer_row rows[2];
#define WHAT_IF(robot, candidates, steps, period, coverage, rows, power)                                                \
    joulebus_questions_what_if(asked, robot, candidates, steps, period, v, omega, coverage, rows, power)
    OK(WHAT_IF(7, 2, 2, 0.1f, 0.9f, rows, power_w));
    HOLDS(rows[0].robot == 7 && fabsf(rows[0].duration_s - 0.2f) < 1e-6f);
    REFUSED(WHAT_IF(4000000000u, 2, 2, 0.1f, 0.9f, rows, NULL), QUESTION, "robot 4000000000 is not in the fleet");
    REFUSED(WHAT_IF(7, 2, 2, 0.1f, NAN, rows, NULL), QUESTION, "a coverage of NaN");
    REFUSED(WHAT_IF(7, 2, 2, NAN, 0.9f, rows, NULL), QUESTION, "a period of NaN");
    REFUSED(WHAT_IF(7, 2, 2, -1.0f, 0.9f, rows, NULL), QUESTION, "a period of -1");
    REFUSED(WHAT_IF(7, 0, 2, 0.1f, 0.9f, rows, NULL), QUESTION, "candidates");
    REFUSED(WHAT_IF(7, 2, 0, 0.1f, 0.9f, rows, NULL), QUESTION, "candidates");
    REFUSED(WHAT_IF(7, SIZE_MAX, 2, 0.1f, 0.9f, rows, NULL), ARGUMENT, "no memory holds");
    REFUSED(WHAT_IF(7, SIZE_MAX / 4, 3, 0.1f, 0.9f, rows, NULL), ARGUMENT, "no memory holds");
    REFUSED(WHAT_IF(7, 2, 2, 0.1f, 0.9f, NULL, NULL), ARGUMENT, "answers is NULL");
    REFUSED(WHAT_IF(7, 2, 2, 0.1f, 0.9f, rows, v), ARGUMENT, "lies in the memory of v_mps");
    v[3] = NAN;
    REFUSED(WHAT_IF(7, 2, 2, 0.1f, 0.9f, rows, NULL), QUESTION, "candidate 1, step 1 is NaN");
    v[3] = 1e9f;
    REFUSED(WHAT_IF(7, 2, 2, 0.1f, 0.9f, rows, NULL), QUESTION, "v_max_mps");
    v[3] = 0.0f;

    uint32_t ids[2] = {7, 3};
    joulebus_question question = {.kind = JOULEBUS_QUERY_KIND_IDLE,
                                  .coverage = 0.9f,
                                  .duration_s = 5.0f,
                                  .robots = ids,
                                  .robot_count = 2};
    joulebus_answers answers = {.rows = rows, .row_capacity = 2};
    OK(joulebus_questions_ask(asked, &question, &answers));
    HOLDS(answers.row_count == 2 && rows[0].robot == 7 && rows[1].robot == 3 && answers.tick > 0);
    answers.row_capacity = 1;
    REFUSED(joulebus_questions_ask(asked, &question, &answers), ARGUMENT, "2 are needed");
    answers.row_capacity = 2;
    question.kind = 77;
    REFUSED(joulebus_questions_ask(asked, &question, &answers), ARGUMENT, "kind of a question is 77");
    question.kind = JOULEBUS_QUERY_KIND_FOLLOW;
    REFUSED(joulebus_questions_ask(asked, &question, &answers), QUESTION, "a path of 0 points");
    joulebus_waypoint path[2] = {{0.0, 0.0, 0.1}, {NAN, 0.0, 0.1}};
    question.path = path;
    question.points = 2;
    REFUSED(joulebus_questions_ask(asked, &question, &answers), QUESTION, "x_m of point 1 is NaN");
    question.points = SIZE_MAX;
    REFUSED(joulebus_questions_ask(asked, &question, &answers), ARGUMENT, "no memory holds");
    question.points = 2;
    question.flags = 0x100;
    REFUSED(joulebus_questions_ask(asked, &question, &answers), ARGUMENT, "flags of a question");
    question.flags = 0;
    path[1].x_m = 0.5;
    OK(joulebus_questions_ask(asked, &question, &answers));
    HOLDS(answers.row_count == 2);
    question.robot_count = 1;
    float few[2];
    answers.power_w = few;
    answers.power_capacity = 2;
    few[0] = few[1] = -1.0f;
    OK(joulebus_questions_ask(asked, &question, &answers));
    HOLDS(answers.power_count > 2 && few[0] == -1.0f && few[1] == -1.0f);
    REFUSED(joulebus_questions_ask(asked, NULL, &answers), ARGUMENT, "question is NULL");
    joulebus_platform platform;
    OK(joulebus_questions_platform(asked, 7, &platform));
    HOLDS(platform.period_s > 0.0f && platform.v_max_mps > 0.0f);
    REFUSED(joulebus_questions_platform(asked, 4000000000u, &platform), QUESTION, "belongs to no platform");
    OK(joulebus_questions_close(asked));

    joulebus_client *client = NULL;
    OK(joulebus_client_open(JOULEBUS_HEADER, config, "misuse", &client));
    question = (joulebus_question){.kind = JOULEBUS_QUERY_KIND_IDLE,
                                   .coverage = 0.9f,
                                   .duration_s = 5.0f,
                                   .robots = ids,
                                   .robot_count = 2};
    answers = (joulebus_answers){.rows = rows, .row_capacity = 2};
    OK(joulebus_client_ask(client, &question, PATIENCE_NS, &answers));
    HOLDS(answers.row_count == 2 && answers.took_ns > 0);
    ids[1] = 4000000000u;
    REFUSED(joulebus_client_ask(client, &question, PATIENCE_NS, &answers), QUESTION, "UnknownRobot");
    question.coverage = NAN;
    REFUSED(joulebus_client_ask(client, &question, PATIENCE_NS, &answers), QUESTION, "");
    OK(joulebus_client_state_battery(client, 7, JOULEBUS_SAMPLE_SOC, 0.5f, "ann", PATIENCE_NS));
    OK(joulebus_client_state_battery(client, 7, JOULEBUS_SAMPLE_FULL, NAN, "ann", PATIENCE_NS));
    REFUSED(joulebus_client_state_battery(client, 7, JOULEBUS_SAMPLE_SOC, NAN, "ann", PATIENCE_NS), QUESTION, "");
    REFUSED(joulebus_client_state_battery(client, 7, JOULEBUS_SAMPLE_SOC, 1.5f, "ann", PATIENCE_NS), QUESTION, "");
    REFUSED(joulebus_client_state_battery(client, 7, JOULEBUS_SAMPLE_FULL, 0.0f, "", PATIENCE_NS), QUESTION, "");
    REFUSED(joulebus_client_state_battery(client, 7, 3, 0.0f, "ann", PATIENCE_NS), ARGUMENT, "JOULEBUS_SAMPLE_SOC");
    REFUSED(joulebus_client_state_battery(client, 7, JOULEBUS_SAMPLE_FULL, 0.0f, NULL, PATIENCE_NS), ARGUMENT, "by is NULL");
    OK(joulebus_client_close(client));
    REFUSED(joulebus_client_ask(client, &question, 0, &answers), HANDLE, "the client is closed");
}

static void predicting(void) {
    joulebus_predictor *model = NULL;
    REFUSED(joulebus_predictor_open(JOULEBUS_HEADER, "builtin:none", &model), MODEL, "gternal-sim");
    REFUSED(joulebus_predictor_open(JOULEBUS_HEADER, "/no/such.safetensors", &model), MODEL, "/no/such.safetensors");
    REFUSED(joulebus_predictor_open(JOULEBUS_HEADER, config, &model), MODEL, config);
    OK(joulebus_predictor_open(JOULEBUS_HEADER, "builtin:gternal-sim", &model));
    enum { ROWS = 200 };
    static float features[ROWS * 11], power_w[ROWS];
    for (size_t at = 0; at < ROWS * 11; at++) {
        features[at] = at % 11 < 6 ? 0.0f : 4.0f;
    }
    features[100 * 11 + 7] = NAN;
    OK(joulebus_predictor_predict(model, features, ROWS, 11, power_w));
    for (size_t at = 0; at < ROWS; at++) {
        HOLDS(at == 100 ? isnan(power_w[at]) : power_w[at] == power_w[0] && power_w[0] > 0.0f);
    }
    OK(joulebus_predictor_predict(model, NULL, 0, 11, NULL));
    REFUSED(joulebus_predictor_predict(model, features, ROWS, 12, power_w), ARGUMENT, "width is 12");
    REFUSED(joulebus_predictor_predict(model, features, SIZE_MAX / 2, 11, power_w), ARGUMENT, "no memory holds");
    REFUSED(joulebus_predictor_predict(model, features, ROWS, 11, features), ARGUMENT, "lies in the memory");
    REFUSED(joulebus_predictor_predict(NULL, features, ROWS, 11, power_w), ARGUMENT, "predictor is NULL");
    float v[6] = {0.1f, 0.1f, 0.1f, 0.0f, 0.0f, 0.0f}, omega[6] = {0}, readings[5] = {4, 4, 4, 4, 4}, energy_j[2];
    joulebus_rollout rollout = {.robots = 1,
                                .candidates = 2,
                                .steps = 3,
                                .step_s = 0.033f,
                                .v_mps = v,
                                .omega_radps = omega,
                                .readings_w = readings};
    float trace[6];
    OK(joulebus_predictor_rollout(model, &rollout, energy_j, trace));
    for (int lane = 0; lane < 2; lane++) {
        float sum = 0.033f * (trace[3 * lane] + trace[3 * lane + 1] + trace[3 * lane + 2]);
        HOLDS(fabsf(sum - energy_j[lane]) < 1e-5f && energy_j[lane] > 0.0f);
    }
    rollout.step_s = NAN;
    REFUSED(joulebus_predictor_rollout(model, &rollout, energy_j, NULL), ARGUMENT, "step_s is NaN");
    rollout.step_s = 0.033f;
    rollout.steps = 0;
    rollout.candidates = SIZE_MAX / 16;
    REFUSED(joulebus_predictor_rollout(model, &rollout, energy_j, NULL), ARGUMENT, "do not fit into memory");
    rollout.candidates = 2;
    rollout.steps = SIZE_MAX;
    REFUSED(joulebus_predictor_rollout(model, &rollout, energy_j, NULL), ARGUMENT, "no memory holds");
    uint64_t hash = 0;
    OK(joulebus_predictor_hash(model, &hash));
    HOLDS(hash != 0);
    OK(joulebus_predictor_close(model));
    REFUSED(joulebus_predictor_predict(model, features, ROWS, 11, power_w), HANDLE, "the predictor is closed");
}

int main(int count, char **arguments) {
    if (count != 2) {
        return 2;
    }
    config = arguments[1];
    versions_and_pointers();
    predicting();
    closed_handles();
    publishing();
    frames();
    threads_and_processes();
    plans();
    printf("%d checks\n", checks);
    return EXIT_SUCCESS;
}
