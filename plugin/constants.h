// All constants that were chosen, with their units and reasons.

#ifndef MJFRAMES_PLUGIN_CONSTANTS_H_
#define MJFRAMES_PLUGIN_CONSTANTS_H_

#include <cstddef>
#include <cstdint>

namespace mjframes {

// [-] pivot of the stiffness of a region's own points, to the largest of its diagonal, of what has no stiffness;
// rounding leaves about 1e-15.
inline constexpr double kSingularShare = 1e-12;

inline constexpr int kMaxMaterials = UINT16_MAX;  // of a body: more than any image has labels

// Elasticity, law `corotational` (corotational.h)

// [-] of κ, to the mean stiffness of a region against shear. The less κ is the smoother the energy where the closest
// rotation jumps; at 1 a region that is stretched to twice its length would turn rather than stretch further.
inline constexpr double kTwistFirmness = 3;
// [-] of an eigenvalue of sym RᵀF, 1 at rest: the rotation of least energy near the closest one is taken for the least
// where all are larger.
inline constexpr double kFolded = 0.4;
inline constexpr int kTurnSteps = 40;       // of Newton's method for R; three or four are usual
inline constexpr int kTurnHalvings = 20;    // of a step that does not go down
inline constexpr double kTurnSlope = 1e-4;  // [-] of the expected descent that a step has to find
inline constexpr double kTurnSure = 1e-5;   // [rad] a shorter step is not checked: energies differ by rounding
inline constexpr double kSameShape = 1e-3;  // [-] of F at rest, to the identity: weights are rounded

// [-] of the curvature C of W in how R turns, to Zᵀ U: from half to twice that a step knows how R turns. Elsewhere, as
// where R is about to jump, it takes Zᵀ U for C, and is firmer: shorter steps do not overshoot while regions turn.
inline constexpr double kSureTurn = 2;
inline constexpr double kUnsureStep = 2;

inline constexpr double kSqrtHalf = 0.70710678118654752440;

// [-] b of pressed.h: what is pressed less is as Hooke's law has it.
inline constexpr double kPressedBegin = 0.15;
// [-] stretch below which pressure grows no faster.
inline constexpr double kPressedEnd = 0.3;
inline constexpr double kAlike = 1e-6;  // [-] between stretches that count as equal

// [-] of Zᵀ U. Points whose places are rounded to 1e-6 of the region's size lie on a line to 1e-12.
inline constexpr double kSingular = 1e-8;

// A step that would make energy (step_correction.h)

// [-] of the points' distance from their middle, which the fastest of them moves in a step: slower bodies are not
// looked at. At 0.02 a thin plate that buckles slowly still gains 6 % of the work that bends it.
inline constexpr double kFastStep = 0.01;
inline constexpr double kMadeEnergy = 1e-4;  // [-] of elastic and kinetic energy: a tenth of what is told as a gain
inline constexpr int kCorrections = 12;      // of a step at most; one or two are usual
inline constexpr double kBetterStep = 0.2;   // [-] a correction that leaves more of what is made calls for damping …
inline constexpr double kDampMore = 4;       // [-] … s of so many times as much, and 1

// Elasticity, other laws (quadrature.h, hessian.h, laws/law.h)

// [-] of I₁, below which laws whose own f'(0) is not 0 are bent (laws/law.h). At 1.5 no second minimum is left for ν ≥
// 0, at 0.9 one is.
inline constexpr double kCollapsing = 1.5;
inline constexpr double kCertain = 1.001;  // [-] beyond which an eigenvalue is certainly above its bound …
inline constexpr double kRounding = 1e-6;  // … and, of |A|, above zero
inline constexpr double kLongestStep = 1;  // [-] the longest Newton step, in F; strains well below it are not affected
inline constexpr double kCalm = 1.5;       // [-] |F| / √3 below which the stiffness of a step is blind to turns
inline constexpr double kInLine = 1e-13;   // [-] of Σ|z|², to which points on a line turn about it unseen
inline constexpr double kLeastVolume = 1e-6;  // [-] least |J| that Cauchy's stress is divided by

// Closest rotation and singular values (rotation.h, svd.h)

// Of Newton's iteration.
inline constexpr int kRotationSteps = 8;      // quadratic convergence: a guess within 1 rad needs 3 to 5
inline constexpr double kRotated = 1e-8;      // [rad] quadratic convergence: the next correction is below rounding
inline constexpr double kTrustRadius = 0.7;   // [rad] longest Newton correction that is followed
inline constexpr double kMinTwist = 1e-6;     // [-] relative to |F|: below, Newton's matrix is useless
inline constexpr int kJacobiSweeps = 12;      // a symmetric matrix of 3 or 4 rows needs at most 6
inline constexpr int kSvdSweeps = 8;          // a 3×3 matrix needs 3 to 5
inline constexpr double kOrthogonal = 1e-30;  // [-] squared cosine between columns that counts as zero; of a matrix,
                                              // its share beside the diagonal

// Kinematics and elimination (kinematics.h, elimination.h)

inline constexpr int kMaxCarried = 10;     // points on one body: those of a quadratic frame
inline constexpr double kSameMass = 1e-4;  // [-] of a body's mass: the model's masses have six digits
inline constexpr int kMaxChain = 16;       // longer ones are cut: their U stays in the first-level cache
inline constexpr int kTile = 4;            // rows that are updated together

// Constraint rows (warm_start.h)

inline constexpr size_t kStackReserve = 1 << 16;  // [bytes] of mjData's stack that are left to others
inline constexpr int kFewRows = 64;          // of an island, that are solved for however few its degrees of freedom are
inline constexpr int kSolverArrays = 32;     // of MuJoCo's Newton solver, beside its matrices; some twenty
inline constexpr int kMostRows = 1024;       // of an island: beyond, the factors of its rows cost more than MuJoCo's,
                                             // and elimination.cc has no memory for them
inline constexpr int kMostIterations = 30;   // of Newton's method; three are usual
inline constexpr int kLineSearchSteps = 30;  // halving alone gets as far as rounding
inline constexpr double kLineSearchSlope = 1e-9;  // [-] of the first one, that counts as zero

// Contact: patches and the deformed volume (patch.h, deformed.h, touch.h)

// The collision hook has only the thread's stack to work on.
inline constexpr int kMaxPatchVertices = 1024;

// A cluster gives at most one contact; MuJoCo 4 allows a plane four with each geom.
inline constexpr int kMaxClusters = 4;
inline constexpr int64_t kMaxLatticeNodes = 1 << 24;  // of the whole lattice: 64 MB of places
// A guess that is off by no more can rule a patch out.
inline constexpr double kTrusted = 2;  // [cubes]

// A node of which the rows have less weight than this belongs to another branch of the tree.
inline constexpr double kLeastInRows = 0.5;                           // [-]
inline constexpr int kTrustedCubes = static_cast<int>(kTrusted) + 1;  // [cubes]
// What is kept while the control points stay where they are; every mjData has it for every soft body, or patch.
inline constexpr int kKeptTouches = 4;     // geoms that a patch keeps its touches with
inline constexpr size_t kKeptNodes = 256;  // of the lattice: those around a finger or two
// Where the scene has other soft bodies, a patch meets more geoms, and their vertices, and flexes, many nodes:
inline constexpr int kKeptSoftTouches = 8;
inline constexpr size_t kKeptSoftNodes = 4096;
// Where points of others are (meetings.h)
inline constexpr int kKeptMeetings = 4;          // other bodies of which a patch keeps where its vertices are in them
inline constexpr size_t kKeptFeatureGeoms = 64;  // rigid geoms of which a body keeps where their features are in it …
inline constexpr size_t kKeptFeatures = 160;     // … and so many features of all, or those of the largest mesh
inline constexpr double kSureStep = 2;           // [cubes] from one vertex to the next, off by a quarter at most
inline constexpr double kFarAbove = 0.5;         // [cubes] nearer to the surface, a ball's middle leaves by its normal
// [cubes] from one point to the next: across a patch; from farther away a nearest vertex is the better guess.
inline constexpr double kTrailStep = 20;
inline constexpr size_t kSharedVertices = 4;  // one in so many may be midway between patches of the other body

inline constexpr double kFound = 1e-13;  // [m] rounding of a world position
inline constexpr int kFindSteps = 20;    // of Newton's method; four are usual
inline constexpr int kFullSteps = 6;     // after these it is damped: it may swing between cubes of unlike slope
inline constexpr double kStride = 3;     // [cubes] longest step
inline constexpr double kTie = 1e-3;     // [cubes] two patches may both have what is midway: neither would be worse
inline constexpr int kClimbs = 3;        // steps up to the surface along the distance's gradient
inline constexpr double kFlatDistance =
    0.05;  // [-] a gradient shorter than this has no direction: midway between two sides
inline constexpr double kOnSurface = 1e-6;  // [cubes]
// From a feature to the other side of something thin: a step in cubes, and how many at most.
inline constexpr double kThroughStep = 0.25, kThroughSteps = 200;
inline constexpr double kFlatPoints = 1e-12;  // [-] of det C of points that are spread evenly: they lie in a plane
inline constexpr double kCollapsed = 1e-6;    // [-] of a cube's rest volume: turned inside out or flat
// [-] by which a distance's gradient differs from 1 in length: with kTrust its direction is the normal, with kNoTrust
// it is that of an edge. Around something round of three voxels' radius it differs by 0.02, next to an edge by up to
// 0.41.
inline constexpr double kTrust = 0.05, kNoTrust = 0.25;
inline constexpr double kFlatSide = 0.99;  // [-] length of the mean of a cluster's unit normals, where it is flat
inline constexpr double kLies = 2;         // [-] a flat cluster lies on something if it touches with half of it
// Over which heights a contact goes to a corner: while it moves there, its force pushes otherwise in the next step, and
// what is lighter than the force jumps to and fro unless it falls by less than that in a step.
inline constexpr double kCornerFall = 3;     // [-] of how far things fall in a step, twice: gravity × timestep²
inline constexpr double kCorner = 0.02;      // [reach] at least, a hundredth of a voxel …
inline constexpr double kCornerMost = 0.25;  // … and at most
// [-] … and the more, the deeper the flat side is: what is pressed hard would tilt to and fro, as the force that moves
// is as a spring of that force over the heights. With 1, and with 2 at high forces, the pads of
// tests/physics/test_firmness.py shake.
inline constexpr double kCornerPressed = 3;
// [-] of a cluster that touches: from the first on, heights exceed kCornerMost; from the second on without a bound.
// What presses less of it, such as a ball, does not press the corner. A soft body bends to the pressed side itself: a
// stack of three shook.
inline constexpr double kCornerFew = 0.1, kCornerMany = 0.225;
// [-] by which the mean of a geom's unit normals is short where it is round.
inline constexpr double kCornerUneven = 0.01;
inline constexpr double kAlong = 0.15;  // [-] cosine of its normal to a contact's: 81° and more
// [-] cosine: two surfaces that face each other by less do not lie on each other.
inline constexpr double kOpposed = 0.5;
inline constexpr double kOutward = 0.5;     // [-] cosine to the surface's normal above which a contact pushes outwards
inline constexpr double kBoxMargin = 1e-9;  // [m] more than rounding
// Round sides of soft bodies (round_side.h)
inline constexpr double kRoundReach = 5;     // [-] ρ over the vertices' spacing: with 3 a ball hops twice as high
inline constexpr double kRoundTie = 0.01;    // [ρ] more than what the places that two patches find differ by
inline constexpr double kRoundStays = 1e-4;  // [ρ] the place has been found
inline constexpr double kRoundStray = 0.3;   // [ρ] how far the place moves before vertices are looked for again
inline constexpr int kRoundSamples = 512;    // vertices around it; some hundred are usual
inline constexpr double kRoundEven = 0.02;   // [1/ρ] a smaller curvature is none
// [ρ] off the quadric: balls of voxels are by 0.01, on edges by 0.03, and legs that are as wide as ρ by 0.13.
inline constexpr double kSmooth = 0.04, kUneven = 0.08;
inline constexpr int kRoundVertices = 8;  // of a cluster at least: a quadric has six terms
// [-] det F over what it were at the same |F|: material of more rolls, of less does not. A ball that is
// squeezed to half its height has 0.6 to 0.77, to a third 0.34 to 0.56.
inline constexpr double kFlatSlope = 0.5, kRoundSlope = 0.75;
inline constexpr double kRoundFacing = 0.5;  // [-] length of the mean of its unit normals
// [1/reach] curvatures: less is flat, or hollow; more is an edge.
inline constexpr double kLeastRound = 0.02, kMostRound = 0.5;
inline constexpr double kRough = 0.1;  // [reach] off a paraboloid; voxels of a ball are by half of it
// Over the surface to where a distance is least (surface_point.h, round_touch.h)
inline constexpr int kRoundSteps = 16;      // five or six are usual
inline constexpr double kRoundStride = 2;   // [cubes] the longest
inline constexpr double kRoundSure = 1e-6;  // [-] of that: a shorter one is not made
inline constexpr double kRoundFit = 3;      // [-] of the vertices' spacing: the curvature is that of those so near
inline constexpr double kRoundStep = 1e-4;  // [-] of the radius: the difference that gives the geom's curvature
inline constexpr double kWidest = 2;        // [-] of the vertices' spacing: the radius of what one contact stands for
inline constexpr double kRoundPressure = 0.221;  // [-] of a²: (0.6 π^(3/2))⁻², over kPressure
// A contact found again at the same place to rounding is the same; anything farther is another one.
inline constexpr double kSamePlace = 1e-9;  // [m]
// Rays go on by the distance, and stop where it vanishes, within forty steps: close is there, and outside a step stays
// on this side of a surface whose distance is interpolated.
inline constexpr double kThere = 1e-3;    // [cubes]
inline constexpr double kCareful = 0.97;  // [-]
// [m] a number that rounds others to 2⁻⁴⁰ m, a picometre, when it is added and taken off: MuJoCo comes back to places
// by other ways, which round otherwise, and each place is looked for once.
inline constexpr double kRounder = 0x1.8p12;
inline constexpr size_t kKeptFieldPoints = 256;        // three times what is asked of a patch for a triangle of a flex
inline constexpr uint64_t kHash = 0x9e3779b97f4a7c15;  // 2⁶⁴ over the golden ratio: spreads places evenly
inline constexpr double kRayStep = 0.5;  // [cubes] where nothing is known but that the surface is not here

// Firmness of contacts (firmness.h)

// [-] n: a contact gives way by a ninth of what a half-space of its flesh does.
inline constexpr double kFirmer = 9;
// [s] T₀ times MuJoCo's largest impedance of 0.95: 15 ms, to which solref of soft and rigid geoms are mixed by default.
inline constexpr double kUsualPeriod = 0.01425;
// [-] of √k depth: a spring with critical damping comes back at 1/e of that at most, halfway from here to twice that.
inline constexpr double kReturn = 0.25;
// [m/s] added to that: what is slow comes back as before. With 0.02 the fit of examples/identify.py got stuck.
inline constexpr double kSlowReturn = 0.05;

// Dents (dents.h)

// [-] of a pressure's variance: the Gaussian that is as far below its middle as a disc's pressure is below its mean.
inline constexpr double kPressure = 0.405;
// [-] of a pressure's variance: the square of where it ends, that of Hertz.
inline constexpr double kPressureEnd = 5;
// [-] of the deepest vertex's depth: what is less deep bears nothing, as beyond the circle where a ball touches.
inline constexpr double kDentEdge = 0.5;
// [-] of the mean height of what shares a contact, to the depth where those are the points that touch (touch.cc).
inline constexpr double kHertz = 8;
// [-] of the variance of points on a punch's edges: that of the pressure below it, (½ − 4/π²) a² for a quarter.
inline constexpr double kEdgePressure = 0.5;
inline constexpr double kEvenPressure = 12;  // [-] of an even pressure's variance: the area of a square of it
// [-] of the depth of the deepest contact: vertices that a drawn geom covers are deeper than a cluster's mean.
inline constexpr double kCovered = 1.5;
inline constexpr int kDentSweeps = 4;     // there and back
inline constexpr int kMostSoftened = 64;  // contacts of a group, of which the inverse of C is made
// erf(x)/x is looked up, between 0 and where erf is 1 to 2e-8.
inline constexpr int kErfPlaces = 128;
inline constexpr double kErfStep = 1.0 / 32;
inline constexpr double kFarDent = 12;  // [-] r²/q beyond which erf(r/√(2q)) is 1 to 5e-4: no dent reaches there

// Contact: rigid geoms (geom_distance.h, hull.h, height_field.h, geom_features.h)

inline constexpr double kNoDirection = 1e-15;  // [m] below this an offset has no direction
inline constexpr double kConverged = 1e-14;    // [-] residual of the ellipsoid's equation
inline constexpr int kNewtonSteps = 50;        // far more than the flattest ellipsoid needs
inline constexpr double kOnTerrain = 1e-9;     // [m] below this an offset is rounding and has no direction
inline constexpr int kFewFaces = 128;          // that are looked at one by one
inline constexpr int kLeafFaces = 8;           // that the tree does not part any more
inline constexpr int kMostDepth = 64;          // of the tree, which is balanced
inline constexpr size_t kMostCorners = 512;    // of a mesh: every 5° all around
inline constexpr double kGoldenAngle = 2.39996322972865332;  // [rad] π (3 − √5): spreads directions evenly
inline constexpr int kMaxFeatureClusters = 8;                // of a geom: one an octant
inline constexpr int kEdgePoints = 3;                        // between the corners of a box: quarters
inline constexpr int kRimPoints = 16;      // of a cylinder: between them the rim bulges by 2 % of the radius
inline constexpr int kCapsulePoints = 17;  // at most, along the axis

// Tendons (tendon.h)

inline constexpr double kMostGrowth = 0.5;  // [-] by which walls that widen change a chamber's pull
inline constexpr double kLeastGas =
    1e-2;  // [-] of its volume at rest: gas that is pressed into less keeps its pressure

// Sensors (places.h)

inline constexpr double kDifference = 1e-5;  // [-] of a region's size that points move in a difference: nine digits

// Taxels (taxels.h, pressing.h)

// [-] of the flesh's thickness: how far around contacts the surface is fitted without its dent, as a Gaussian's width.
// With 1 its tilt is that of the dent; a pad's pressures are off by 3 % more.
inline constexpr double kFitWidth = 2;
// [-] of the flesh's stiffness against tilting, by which what turns freely is held to its moment: it misses a
// thirtieth.
inline constexpr double kTurn = 30;
inline constexpr double kFacing = 0.2;     // [-] cosine: what faces farther away than 78° does not touch the same thing
inline constexpr double kFlatFit = 1e-6;   // [-] of squared lengths: places on a line have no plane
inline constexpr int kPressSteps = 60;     // 10 to 25 are usual
inline constexpr double kPressed = 1e-4;   // [-] of the load: what moves in the last step
inline constexpr double kContent = 1e-12;  // [-] of where the surface is, by which it is off from the shape: rounding
inline constexpr double kKeptLoad = 0.1;   // [-] of the load, of which a step may cut off no more

}  // namespace mjframes

#endif  // MJFRAMES_PLUGIN_CONSTANTS_H_
