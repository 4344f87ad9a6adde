// The slide gate's protocol and watchdog, independent of Arduino, so that the same file runs on the
// board and in FLIP's tests.
// The lines are described in crates/flip-bench/src/hardware/gate/protocol.rs.
//
// The gate is to be closed after a reset, after CLOSE, after HELLO, and when no heartbeat has
// arrived for 500 ms while it is to be open.
// A line is obeyed once: the newest number gets the same reply again, older ones are refused, and
// after a reset all are refused until HELLO.

#ifndef FLIP_GATE_PROTOCOL_H
#define FLIP_GATE_PROTOCOL_H

#include <stdint.h>
#include <stdio.h>
#include <string.h>

namespace flip_gate {

const uint16_t VERSION = 1;
// An open gate closes after this long without a heartbeat, ms.
const uint32_t WATCHDOG_MS = 500;
// Travel time of the slide from end to end, ms; the servo is ramped so that it does not throw
// powder.
const uint32_t TRAVEL_MS = 400;
// Time after arrival by which an end stop must be pressed, ms.
const uint32_t SETTLE_MS = 300;
const uint16_t OPEN_PERMILLE = 1000;
// Maximum length of a line to the board, and of one from it.
const uint8_t LINE_BYTES_MAX = 40;
const uint8_t REPLY_BYTES_MAX = 64;

// CRC-16/CCITT-FALSE: polynomial 0x1021 from 0xFFFF, high bit first.
inline uint16_t checksum(const char* text, uint8_t length) {
  uint16_t sum = 0xFFFF;
  for (uint8_t i = 0; i < length; ++i) {
    sum = static_cast<uint16_t>(sum ^ (static_cast<uint16_t>(static_cast<uint8_t>(text[i])) << 8));
    for (uint8_t bit = 0; bit < 8; ++bit) {
      sum = static_cast<uint16_t>((sum & 0x8000u) ? (sum << 1) ^ 0x1021u : (sum << 1));
    }
  }
  return sum;
}

// The end stops, as wired.
struct Stops {
  bool closed;
  bool open;
};

class Gate {
 public:
  // Sends one line, with its terminator.
  typedef void (*Say)(const char* line);

  explicit Gate(Say say) : say_(say) { reset(0); }

  // The board starts: closed, and nothing is obeyed until HELLO.
  void reset(uint32_t now_ms) {
    target_ = 0;
    position_ = 0;
    from_ = 0;
    moved_ms_ = now_ms;
    beat_ms_ = now_ms;
    is_open_wanted_ = false;
    why_ = "RESET";
    has_session_ = false;
    newest_ = 0;
    length_ = 0;
    reply_[0] = '\0';
  }

  // The board has started; call once the end stops have been read.
  void hello(uint32_t now_ms, Stops stops) {
    tick(now_ms, stops);
    answer(0, true);
    say_(reply_);
  }

  // Process a received character.
  void hear(char c, uint32_t now_ms, Stops stops) {
    tick(now_ms, stops);
    if (c != '\n' && c != '\r') {
      // A line that is too long is cut, so that its checksum is wrong.
      if (length_ < LINE_BYTES_MAX) line_[length_++] = c;
      return;
    }
    if (length_ > 0) take();
    length_ = 0;
  }

  // Advance the time: the slide moves on, and closes once heartbeats have stopped.
  void tick(uint32_t now_ms, Stops stops) {
    now_ms_ = now_ms;
    stops_ = stops;
    if (is_open_wanted_ && now_ms - beat_ms_ >= WATCHDOG_MS) close("BEATS");
    const uint32_t way = distance(from_, target_);
    const uint32_t gone = (now_ms - moved_ms_) * OPEN_PERMILLE / TRAVEL_MS;
    if (gone >= way) {
      position_ = target_;
    } else {
      position_ = static_cast<uint16_t>(target_ > from_ ? from_ + gone : from_ - gone);
    }
    // Advanced, so that neither the product above nor the clock wraps while the slide rests.
    if (position_ == target_ && now_ms - moved_ms_ > 10000) {
      from_ = target_;
      moved_ms_ = now_ms - 10000;
    }
  }

  // Commanded position of the slide now, thousandths.
  uint16_t position() const { return position_; }

 private:
  static uint32_t distance(uint16_t a, uint16_t b) { return a > b ? a - b : b - a; }

  void head_for(uint16_t target) {
    from_ = position_;
    target_ = target;
    moved_ms_ = now_ms_;
  }

  void close(const char* why) {
    is_open_wanted_ = false;
    why_ = why;
    head_for(0);
  }

  const char* state() const {
    if (position_ != target_) return "MOVING";
    const bool has_arrived = target_ == 0               ? stops_.closed && !stops_.open
                             : target_ == OPEN_PERMILLE ? stops_.open && !stops_.closed
                                                        : !stops_.closed && !stops_.open;
    if (has_arrived) return target_ == 0 ? "CLOSED" : "OPEN";
    const uint32_t arrival_ms = distance(from_, target_) * TRAVEL_MS / OPEN_PERMILLE;
    return now_ms_ - moved_ms_ < arrival_ms + SETTLE_MS ? "MOVING" : "STUCK";
  }

  void take() {
    uint8_t end = 0;
    if (!text_end(&end)) return say_error("CHECKSUM");
    line_[end] = '\0';
    char* word = strchr(line_, ' ');
    if (word == NULL) return say_error("FORM");
    *word++ = '\0';
    uint16_t seq = 0;
    if (!number(line_, &seq) || seq == 0) return say_error("FORM");
    if (strcmp(word, "HELLO") == 0) {
      if (is_open_wanted_) close("ASKED");
      has_session_ = true;
      answer(seq, true);
    } else if (!has_session_) {
      return refuse(seq, "HELLO");
    } else if (seq == newest_) {
      return say_(reply_);
    } else if (static_cast<uint16_t>(seq - newest_) > 0x7FFF) {
      return refuse(seq, "OLD");
    } else {
      const char* refusal = obey(word);
      if (refusal == NULL) {
        answer(seq, false);
      } else {
        write_refusal(seq, refusal);
      }
    }
    newest_ = seq;
    say_(reply_);
  }

  // Obeys a command; returns why it does not.
  const char* obey(const char* word) {
    uint16_t opening = 0;
    if (strcmp(word, "STATUS") == 0) return NULL;
    if (strcmp(word, "BEAT") == 0) {
      beat_ms_ = now_ms_;
      return NULL;
    }
    if (strcmp(word, "CLOSE") == 0) {
      if (is_open_wanted_) close("ASKED");
      return NULL;
    }
    if (strncmp(word, "OPEN ", 5) != 0) return "COMMAND";
    if (!number(word + 5, &opening) || opening == 0 || opening > OPEN_PERMILLE) return "ARGUMENT";
    is_open_wanted_ = true;
    beat_ms_ = now_ms_;
    head_for(opening);
    return NULL;
  }

  // Finds where the text of a line ends, if its checksum is correct.
  bool text_end(uint8_t* end) const {
    if (length_ < 5 || line_[length_ - 5] != '*') return false;
    uint16_t sum = 0;
    for (uint8_t i = static_cast<uint8_t>(length_ - 4); i < length_; ++i) {
      const char c = line_[i];
      const bool is_digit = c >= '0' && c <= '9';
      if (!is_digit && !(c >= 'A' && c <= 'F')) return false;
      sum = static_cast<uint16_t>(sum << 4 | (is_digit ? c - '0' : c - 'A' + 10));
    }
    *end = static_cast<uint8_t>(length_ - 5);
    return sum == checksum(line_, *end) && memchr(line_, '\0', *end) == NULL;
  }

  static bool number(const char* text, uint16_t* value) {
    uint32_t sum = 0;
    if (*text == '\0') return false;
    for (; *text != '\0'; ++text) {
      if (*text < '0' || *text > '9') return false;
      sum = sum * 10 + static_cast<uint32_t>(*text - '0');
      if (sum > 0xFFFF) return false;
    }
    *value = static_cast<uint16_t>(sum);
    return true;
  }

  const char* stops() const {
    if (stops_.closed) return stops_.open ? "B" : "C";
    return stops_.open ? "O" : "-";
  }

  // Write the reply, which is kept in case the line is repeated.
  void answer(uint16_t seq, bool is_hello) {
    char kind[12];
    snprintf(kind, sizeof kind, is_hello ? "HI %u" : "OK", static_cast<unsigned>(VERSION));
    snprintf(reply_, sizeof reply_, "%u %s %s %u %s %s", static_cast<unsigned>(seq), kind, state(), static_cast<unsigned>(position_), stops(),
             is_open_wanted_ ? "-" : why_);
    finish(reply_);
  }

  void write_refusal(uint16_t seq, const char* why) {
    snprintf(reply_, sizeof reply_, "%u ERR %s", static_cast<unsigned>(seq), why);
    finish(reply_);
  }

  // Refuse without forgetting the reply to the newest line.
  void refuse(uint16_t seq, const char* why) {
    char line[REPLY_BYTES_MAX];
    snprintf(line, sizeof line, "%u ERR %s", static_cast<unsigned>(seq), why);
    finish(line);
    say_(line);
  }

  void say_error(const char* why) { refuse(0, why); }

  // Append checksum and terminator to a text that has room for them.
  static void finish(char* text) {
    const uint8_t length = static_cast<uint8_t>(strlen(text));
    snprintf(text + length, REPLY_BYTES_MAX - length, "*%04X\n", static_cast<unsigned>(checksum(text, length)));
  }

  Say say_;
  uint32_t now_ms_ = 0;
  uint32_t moved_ms_;
  uint32_t beat_ms_;
  uint16_t from_;
  uint16_t target_;
  uint16_t position_;
  Stops stops_ = {false, false};
  bool is_open_wanted_;
  const char* why_;
  bool has_session_;
  uint16_t newest_;
  char line_[LINE_BYTES_MAX + 1];
  uint8_t length_;
  char reply_[REPLY_BYTES_MAX];
};

}  // namespace flip_gate

#endif
