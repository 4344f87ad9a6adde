// The slide gate under FLIP's funnel: an Arduino Uno or compatible, a servo that moves the slide,
// and two end stops.
//
//   pin 9   servo
//   pin 2   closed end stop, to ground when pressed
//   pin 3   open end stop, to ground when pressed
//
// Opening the serial port resets the board (DTR), and a reset closes the gate. This sketch cannot
// close a gate without power: fit the slide with a spring that does, and give the servo its own
// supply.
//
// Copy this file and gate_protocol.h into a folder named flip_gate and load it with the Arduino IDE
// (library: Servo).

#include <Servo.h>
#ifdef __AVR__
#include <avr/wdt.h>
#endif

#include "gate_protocol.h"

const uint8_t SERVO_PIN = 9;
const uint8_t CLOSED_STOP_PIN = 2;
const uint8_t OPEN_STOP_PIN = 3;
// Servo pulse widths at the ends of the slide: measure them on the actual gate.
const uint16_t CLOSED_US = 1000;
const uint16_t OPEN_US = 2000;

void say(const char* line) { Serial.print(line); }

flip_gate::Gate gate(say);
Servo servo;

flip_gate::Stops stops() { return {digitalRead(CLOSED_STOP_PIN) == LOW, digitalRead(OPEN_STOP_PIN) == LOW}; }

void lead_servo() {
  const uint32_t way = OPEN_US - CLOSED_US;
  servo.writeMicroseconds(CLOSED_US + static_cast<uint16_t>(way * gate.position() / flip_gate::OPEN_PERMILLE));
}

void setup() {
  pinMode(CLOSED_STOP_PIN, INPUT_PULLUP);
  pinMode(OPEN_STOP_PIN, INPUT_PULLUP);
  gate.reset(millis());
  servo.attach(SERVO_PIN);
  lead_servo();
  Serial.begin(115200);
  delay(flip_gate::SETTLE_MS);
#ifdef __AVR__
  // A loop that hangs resets the board, which closes the gate. Old bootloaders do not survive this:
  // load a current one (Optiboot).
  wdt_enable(WDTO_250MS);
#endif
  gate.hello(millis(), stops());
}

void loop() {
#ifdef __AVR__
  wdt_reset();
#endif
  while (Serial.available() > 0) gate.hear(static_cast<char>(Serial.read()), millis(), stops());
  gate.tick(millis(), stops());
  lead_servo();
}
