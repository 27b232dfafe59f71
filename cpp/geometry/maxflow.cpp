#include "geometry/maxflow.h"
