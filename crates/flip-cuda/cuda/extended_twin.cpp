// The twin of spoons whose grains turn.
#define FLIP_EXTENDED
#include "twin.cpp"
