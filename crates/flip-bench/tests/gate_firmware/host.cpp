// The gate's sketch on this computer: gate_protocol.h behind a pseudo-terminal, with a slide that is made of arithmetic.
//
// Prints the path of its port, then serves it until its standard input ends. Opening the port resets the board, as it does an Arduino.
// The first argument is how long the board then is silent, ms; a second one is where the slide jams, thousandths.

#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "../../src/hardware/gate_firmware/gate_protocol.h"

static int port = -1;

static void say(const char* line) {
  if (write(port, line, strlen(line)) < 0) perror("write");
}

static uint32_t now_ms() {
  timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return static_cast<uint32_t>(now.tv_sec * 1000u + now.tv_nsec / 1000000);
}

// The slide follows the servo unless it jams.
struct Slide {
  long at;
  long jam;

  flip_gate::Stops follow(long servo) {
    at = jam >= 0 && servo > jam ? jam : servo;
    return {at == 0, at == flip_gate::OPEN_PERMILLE};
  }
};

// Whether somebody has the port open.
static bool is_open() {
  pollfd look = {port, 0, 0};
  return poll(&look, 1, 0) >= 0 && !(look.revents & POLLHUP);
}

static int open_port() {
  port = posix_openpt(O_RDWR | O_NOCTTY);
  if (port < 0 || grantpt(port) != 0 || unlockpt(port) != 0) return -1;
  const int terminal = open(ptsname(port), O_RDWR | O_NOCTTY);
  termios raw;
  if (terminal < 0 || tcgetattr(terminal, &raw) != 0) return -1;
  cfmakeraw(&raw);
  if (tcsetattr(terminal, TCSANOW, &raw) != 0) return -1;
  // Not kept open, so that it is seen when somebody else opens it.
  close(terminal);
  return 0;
}

int main(int count, char** arguments) {
  const uint32_t boot_ms = count > 1 ? static_cast<uint32_t>(atol(arguments[1])) : 2000;
  Slide slide = {0, count > 2 ? atol(arguments[2]) : -1};
  if (open_port() != 0) {
    perror("pseudo-terminal");
    return 1;
  }
  printf("%s\n", ptsname(port));
  fflush(stdout);

  flip_gate::Gate gate(say);
  bool was_open = false;
  bool has_started = false;
  uint32_t reset_ms = now_ms();
  for (;;) {
    pollfd look[2] = {{port, POLLIN, 0}, {STDIN_FILENO, POLLIN, 0}};
    const bool is_open_now = is_open();
    // A port that nobody has open is always "ready".
    poll(is_open_now ? look : look + 1, is_open_now ? 2 : 1, 2);
    char bytes[256];
    if ((look[1].revents & (POLLIN | POLLHUP)) && read(STDIN_FILENO, bytes, sizeof bytes) <= 0) return 0;

    const uint32_t now = now_ms();
    if (is_open_now && !was_open) {
      gate.reset(now);
      reset_ms = now;
      has_started = false;
    }
    was_open = is_open_now;
    if (!has_started && now - reset_ms >= boot_ms) {
      has_started = true;
      gate.hello(now, slide.follow(gate.position()));
    }
    gate.tick(now, slide.follow(gate.position()));
    if (is_open_now && (look[0].revents & POLLIN)) {
      const ssize_t came = read(port, bytes, sizeof bytes);
      for (ssize_t i = 0; has_started && i < came; ++i) gate.hear(bytes[i], now_ms(), slide.follow(gate.position()));
    }
  }
}
