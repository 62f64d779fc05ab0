! Mohr-Coulomb's perfect plasticity, returned in principal stresses.
! PROPS: E (Pa), nu, cohesion (Pa), friction angle, dilation angle (degrees; friction above 0).
! Clausen, Damkilde & Andersen (2007), doi 10.1016/j.compstruc.2007.04.008.
subroutine umat(stress, statev, ddsdde, sse, spd, scd, rpl, ddsddt, drplde, drpldt, stran, &
    dstran, time, dtime, temp, dtemp, predef, dpred, cmname, ndi, nshr, ntens, nstatv, props, &
    nprops, coords, drot, pnewdt, celent, dfgrd0, dfgrd1, noel, npt, layer, kspt, jstep, kinc)
  implicit none
  integer :: ndi, nshr, ntens, nstatv, nprops, noel, npt, layer, kspt, jstep(4), kinc
  real(8) :: stress(ntens), statev(*), ddsdde(ntens, ntens), sse, spd, scd, rpl, ddsddt(ntens)
  real(8) :: drplde(ntens), drpldt, stran(ntens), dstran(ntens), time(2), dtime, temp, dtemp
  real(8) :: predef(1), dpred(1), props(nprops), coords(3), drot(3, 3), pnewdt, celent
  real(8) :: dfgrd0(3, 3), dfgrd1(3, 3)
  character(80) :: cmname
  real(8), parameter :: degree = acos(-1d0)/180
  real(8) :: elastic(3, 3), inverse(3, 3), C(3, 3), G, lambda, k, m, strength, apex(3)
  real(8) :: trial(3), sigma(3), values(3), cosines(3, 3), n(3, 3), basis(ntens), f, secant
  real(8) :: a(3), b(3), along(3), flow(3), t
  integer :: i, j, order(3)

  G = props(1)/(2*(1 + props(2)))
  lambda = props(1)*props(2)/((1 + props(2))*(1 - 2*props(2)))
  ddsdde = 0
  ddsdde(1:3, 1:3) = lambda
  elastic = lambda
  do i = 1, ntens
    ddsdde(i, i) = ddsdde(i, i) + merge(2*G, G, i <= 3)
    if (i <= 3) elastic(i, i) = elastic(i, i) + 2*G
  end do
  stress = stress + matmul(ddsdde, dstran)

  k = (1 + sin(degree*props(4)))/(1 - sin(degree*props(4)))
  m = (1 + sin(degree*props(5)))/(1 - sin(degree*props(5)))
  strength = 2*props(3)*sqrt(k)
  call sprind(stress, values, cosines, 1, ndi, nshr)
  order = [1, 2, 3]
  if (values(order(1)) < values(order(2))) order(1:2) = order([2, 1])
  if (values(order(2)) < values(order(3))) order(2:3) = order([3, 2])
  if (values(order(1)) < values(order(2))) order(1:2) = order([2, 1])
  trial = values(order)
  n = cosines(order, :)
  f = k*trial(1) - trial(3) - strength
  if (f <= 0) return

  a = [k, 0d0, -1d0]
  b = [m, 0d0, -1d0]
  flow = matmul(elastic, b)
  sigma = trial - f*flow/dot_product(a, flow)
  C = elastic - outer(flow, matmul(elastic, a))/dot_product(a, flow)
  if (sigma(1) < sigma(2) .or. sigma(2) < sigma(3)) then
    ! an edge, where two stresses are equal; its end is the apex
    apex = strength/(k - 1)
    inverse = -props(2)/props(1)
    do i = 1, 3
      inverse(i, i) = 1/props(1)
    end do
    along = [1d0, 1d0, k]
    b = [1d0, 1d0, m]
    if (sigma(2) < sigma(3)) then
      along = [1d0, k, k]
      b = [1d0, m, m]
    end if
    flow = matmul(inverse, b)
    t = dot_product(flow, trial - apex)/dot_product(flow, along)
    sigma = apex + t*along
    C = outer(along, b)/dot_product(flow, along)
    if (t > 0) then
      sigma = apex
      C = 0
    end if
  end if

  ! back from the principal axes: the secant of two stresses turns with the axes
  stress = 0
  ddsdde = 0
  do i = 1, 3
    stress = stress + sigma(i)*dyad(i, i)
    do j = 1, 3
      ddsdde = ddsdde + C(i, j)*outer(dyad(i, i), dyad(j, j))
    end do
    j = mod(i, 3) + 1
    if (abs(trial(i) - trial(j)) > 1d-9*maxval(abs(trial))) then
      secant = 2*G*(sigma(i) - sigma(j))/(trial(i) - trial(j))
    else
      secant = (C(i, i) - C(i, j) - C(j, i) + C(j, j))/2
    end if
    basis = dyad(i, j)
    ddsdde = ddsdde + 2*secant*outer(basis, basis)
  end do

contains

  function outer(x, y) result(z)
    real(8), intent(in) :: x(:), y(:)
    real(8) :: z(size(x), size(y))
    z = spread(x, 2, size(y))*spread(y, 1, size(x))
  end function

  ! symmetric part of n_i n_j, with tensor components
  function dyad(i, j) result(z)
    integer, intent(in) :: i, j
    real(8) :: z(ntens)
    z(1:3) = n(i, :)*n(j, :)
    z(4) = (n(i, 1)*n(j, 2) + n(j, 1)*n(i, 2))/2
    if (ntens == 6) then
      z(5) = (n(i, 1)*n(j, 3) + n(j, 1)*n(i, 3))/2
      z(6) = (n(i, 2)*n(j, 3) + n(j, 2)*n(i, 3))/2
    end if
  end function

end subroutine
