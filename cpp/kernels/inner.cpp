#include "kernels/inner.h"
