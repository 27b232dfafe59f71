#include "kernels/biharmonic.h"
